"""The label: what tagmill knows about one frame. Same types on the bus and in the label file.

Units: millimetres, pixels (integer = pixel centre), radians in rotation vectors, degrees where a field says so.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from common.evidence import MadeFrom
from common.parts import Matrix3 as Matrix3
from common.parts import Part as Part
from common.parts import Point as Point
from common.parts import Quad as Quad
from common.parts import Row4 as Row4
from common.parts import Vector3 as Vector3

LABEL_SCHEMA: Literal["tagmill.label/1"] = "tagmill.label/1"

FaceName = Literal["front", "back", "left", "right", "top", "bottom"]


class Window(Part):
    """An axis-aligned bounding box in pixels; may reach outside the picture where it says *unclipped*."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float


class Corner(Part):
    """One of the box's eight corners; ``x`` and ``y`` are None where it lies behind the camera.

    ``visible``: in the picture and hidden by nothing, neither its own box nor anything before it; None: not looked at.
    """

    name: str
    x: float | None
    y: float | None
    in_image: bool
    visible: bool | None = None


class PoseLabel(Part):
    """Object frame to camera frame: Rodrigues vector (rad), translation (mm), the same as a 4x4 matrix."""

    rvec: Vector3
    tvec_mm: Vector3
    matrix: tuple[Row4, Row4, Row4, Row4]


class SideLabel(Part):
    """A side of which a marker was seen; one entry a marker."""

    class_name: Annotated[str, Field(alias="class")]
    face: FaceName
    marker: int
    marker_corners: Quad
    corners_kind: str
    distance_mm: float
    distance_joint_mm: float
    viewing_angle_deg: float
    residual_px: float
    polygon: tuple[Point, ...]
    visible_share: float | None = None


class FaceLabel(Part):
    """A face that is turned to the camera, whether a marker of it was seen or not.

    ``class`` is None where the rig gives that face no side; ``visible_share`` is the share (0..1) of the face's
    area that is in the picture and hidden by nothing.
    """

    face: FaceName
    class_name: Annotated[str | None, Field(alias="class")] = None
    visible_share: float


class Uncertainty(Part):
    """Error bars, one sigma: the root mean square of the error to expect from the corners' noise.

    ``corners_px`` are of the eight corners in their order (distance in the picture), None behind the camera.
    """

    distance_mm: float
    rotation_deg: float
    corners_px: tuple[float | None, ...]


class Quality(Part):
    """How far an object's pose can be trusted."""

    reprojection_error_px: float
    markers: int
    ambiguous: bool = False
    alternative_pose: PoseLabel | None = None
    uncertainty: Uncertainty | None = None


class ObjectLabel(Part):
    """One object in one frame. ``source`` names what found it: ``markers``, or a later detector's name.

    ``pose_source``: ``measured`` from detected markers, ``tracked`` from markers found where they had to be,
    ``interpolated`` between the frames before and after. ``visibility`` says what visible corners, sides and
    ``faces`` were judged by; None: not looked at.
    """

    id: int
    name: str
    type: str
    source: str = "markers"
    pose_source: Literal["measured", "interpolated", "tracked"] = "measured"
    sides: tuple[SideLabel, ...]
    pose: PoseLabel
    corners: tuple[Corner, ...]
    window: Window | None
    window_unclipped: Window
    distance_mm: float
    quality: Quality
    faces: tuple[FaceLabel, ...] = ()
    visibility: Literal["geometry", "depth"] | None = None


class Missing(Part):
    """An object that was seen a moment ago and should still be in the picture, but has no pose; ``reason``: why.

    not_detected, or what kept its markers from a pose: bad_pose, contradicts, duplicate_marker.
    """

    object: str
    reason: str
    seen_ms_ago: float | None = None


class LeftOut(Part):
    """A marker that gave no side, and why: unknown_marker, duplicate_marker, not_detected, bad_pose, contradicts.

    ``residual_px``: how far (rms) a marker that contradicts lies from where the object's others put it.
    """

    marker: int
    reason: str
    object: str | None = None
    corners: Quad | None = None
    residual_px: float | None = None


class DetectedWindow(Part):
    """A detection that isn't a marker: what a second, named source (a model) saw."""

    class_name: Annotated[str, Field(alias="class")]
    score: float
    window: Window


class SourceDetections(Part):
    """The detections of one named source other than the markers, for the frame of the label."""

    source: str
    windows: tuple[DetectedWindow, ...]


class CameraLabel(Part):
    """The camera as it was for this frame; the intrinsics are those of the stored picture."""

    name: str
    width: int
    height: int
    matrix: Matrix3
    distortion: tuple[float, ...]
    model: Literal["pinhole", "fisheye"] = "pinhole"
    intrinsics_from: Literal["calibration", "factory", "truth", "guess"] = "calibration"
    serial: str | None = None


class DepthLabel(Part):
    """How to read the depth picture: ``value * unit_mm`` is mm along the optical axis, 0 is invalid."""

    unit_mm: float


class ErasedPolygon(Part):
    """One erased region; ``marker`` is the marker's id, ``because`` detected or pose."""

    marker: int
    because: Literal["detected", "pose"]
    polygon: tuple[Point, ...]


class Erased(Part):
    """What was inpainted and how."""

    method: str
    margin: str
    polygons: tuple[ErasedPolygon, ...]


class StoredFile(Part):
    """A file of a sample; ``path`` is relative to the session folder."""

    path: str
    size: int
    sha256: str


class SampleFiles(Part):
    """The files a label belongs to; readers go by these, never by a built path."""

    rgb: StoredFile
    depth: StoredFile | None = None
    original: StoredFile | None = None


class PairLabel(Part):
    """The frames of several cameras that `record --camera all` took together.

    ``reference``: the camera whose frame the others' had to be nearest to; ``offset_ms``: this frame's time minus that
    one's; ``spread_ms``: from the first to the last of all. ``samples``: camera to sample name; one that was refused
    at the last has no files.
    """

    reference: str
    offset_ms: float
    spread_ms: float
    samples: dict[str, str]


class Label(Part):
    """The label file (``label_<sample>.json``); on its way to the store ``files`` is still None.

    ``made_from``: what the exact labels were made from, where the original is kept with it: `tagmill relabel`.
    """

    schema_: Annotated[Literal["tagmill.label/1"], Field(alias="schema")] = LABEL_SCHEMA
    sample: str
    session: str
    recording: str | None
    camera: CameraLabel
    frame: int
    boot: str
    source_name: str | None
    captured_at: str
    captured_wall_ns: int
    captured_mono_ns: int
    device_ns: int | None
    depth: DepthLabel | None
    background: bool
    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...]
    detections: tuple[SourceDetections, ...] = ()
    inpainted: Erased
    complete: bool = True
    missing: tuple[Missing, ...] = ()
    pair: PairLabel | None = None
    made_from: MadeFrom | None = None
    files: SampleFiles | None = None
    versions: dict[str, str]
