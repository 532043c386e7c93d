"""The rig file's fields. Every default a user relies on stands here; the loader adds file and line to mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from common.config.addresses import address_fault
from common.config.dataset import DatasetConfig
from common.config.realsense import RealSenseOptions
from common.config.section import Section
from common.ids import NAME_PATTERN
from common.labels import FaceName
from common.ledgers import AutoLimits

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
PositiveMm = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Millimetres = Annotated[float, Field(allow_inf_nan=False)]


class MarkersConfig(Section):
    """``family``: a cv2 predefined dictionary's name (any case, with or without ``DICT_``) or a file.

    ``detector``: who searches; ``auto`` takes what the benchmark shows to be best for the family.
    """

    family: str = "apriltag_36h11"
    detector: Literal["auto", "opencv", "apriltag", "locus"] = "auto"


class SizeConfig(Section):
    """Width and height as seen from the front (or from a side, where it stands there), and depth, in mm."""

    width: PositiveMm
    height: PositiveMm
    depth: PositiveMm


class PlacementConfig(Section):
    """One marker on a side. ``marker_size_mm`` is the black square, ``border_mm`` the white margin around it."""

    marker: Annotated[int, Field(ge=0)]
    marker_size_mm: PositiveMm
    border_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    offset_mm: Annotated[tuple[Millimetres, ...], Field(min_length=2, max_length=3)] = (0.0, 0.0)
    rotation_deg: Millimetres = 0.0


class SideConfig(Section):
    """A side: its class is the key. Either one marker in place or a list ``markers``."""

    face: FaceName | None = None
    size_mm: SizeConfig | None = None
    marker: Annotated[int, Field(ge=0)] | None = None
    marker_size_mm: PositiveMm | None = None
    border_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    offset_mm: Annotated[tuple[Millimetres, ...], Field(min_length=2, max_length=3)] | None = None
    rotation_deg: Millimetres | None = None
    markers: Annotated[tuple[PlacementConfig, ...], Field(min_length=1)] | None = None


class ObjectConfig(Section):
    """A physical object: a cuboid with markers on its sides."""

    name: Name
    type: str | None = None
    size_mm: SizeConfig | None = None
    sides: Annotated[dict[Name, SideConfig], Field(min_length=1)]


class CameraConfig(BaseModel):
    """A camera; further keys belong to its driver (``options``)."""

    model_config = ConfigDict(frozen=True, extra="allow")

    driver: str
    calibration: Path | None = None
    width: Annotated[int, Field(ge=16, le=16384)] | None = None
    height: Annotated[int, Field(ge=16, le=16384)] | None = None
    fps: Annotated[float, Field(gt=0, le=1000)] | None = None

    @property
    def options(self) -> dict[str, Any]:
        """The driver's own keys."""
        return dict(self.model_extra or {})


class NetworkConfig(Section):
    """Sockets. ``keys`` is a folder of CURVE keys, needed when ``command`` is not on loopback.

    ``console``: the web page's address, null for none; off loopback it demands the token in its log.
    """

    prefix: Name = "tagmill"
    command: str = "tcp://127.0.0.1:5750"
    console: str | None = "http://127.0.0.1:8750"
    keys: Path | None = None


class WorkersConfig(Section):
    """How many processes share the cameras.

    ``finish``: of each label process, those that make exact labels and erase; ``store``: those that encode and write.
    """

    detect: Annotated[int, Field(ge=1, le=64)] = 1
    label: Annotated[int, Field(ge=1, le=64)] = 1
    finish: Annotated[int, Field(ge=1, le=64)] = 2
    store: Annotated[int, Field(ge=1, le=64)] = 2


class RingConfig(Section):
    """Slots of a camera's frame ring and of a label process's sample ring (= how many samples may wait)."""

    slots: Annotated[int, Field(ge=3, le=1024)] = 12
    samples: Annotated[int, Field(ge=1, le=1024)] = 64


class RecordConfig(Section):
    """``incomplete``: what to do with a frame in which an object that must be there has no pose.

    ``auto``: what `start` with `mode: auto` takes, unless it says otherwise.
    """

    incomplete: Literal["refuse", "keep"] = "refuse"
    auto: AutoLimits = AutoLimits()


class PoseConfig(Section):
    """``ambiguous``: a lone marker whose two poses fit alike and whose corners differ by more than ``ambiguous_px``."""

    ambiguous: Literal["refuse", "keep"] = "refuse"
    ambiguous_px: Annotated[float, Field(gt=0)] = 6.0


class InpaintConfig(Section):
    """How markers are erased. ``margin``: beyond the white border, as a share of the marker's size.

    ``radius_px`` belongs to ``telea`` and ``ns``.
    """

    method: Literal["plane", "smooth", "telea", "ns"] = "plane"
    margin: Annotated[float, Field(ge=0, le=2)] = 0.15
    radius_px: Annotated[float, Field(gt=0, le=50)] = 3.0


class RigConfig(Section):
    """A whole ``rig.yaml``. ``extrinsics``: a file that says where cameras stand to each other."""

    dataset: DatasetConfig = DatasetConfig()
    markers: MarkersConfig = MarkersConfig()
    objects: tuple[ObjectConfig, ...] = ()
    cameras: dict[Name, CameraConfig] = {}
    extrinsics: Path | None = None
    network: NetworkConfig = NetworkConfig()
    workers: WorkersConfig = WorkersConfig()
    ring: RingConfig = RingConfig()
    record: RecordConfig = RecordConfig()
    pose: PoseConfig = PoseConfig()
    inpaint: InpaintConfig = InpaintConfig()


_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)
"""How many coefficients cv2's pinhole model can have; none is a lens without distortion."""


class SyntheticOptions(Section):
    """Keys of ``driver: synthetic``. The scene moves on a path that follows from ``seed``.

    ``pace: consumer``: the next frame comes as soon as the one before is labelled, to see what a machine can do.

    ``view``: degrees by which this camera went round the scene's middle; cameras of one seed see one scene.
    ``board``: a calibration board's description; the camera shows that board, held at one pose after another, and no
    object. ``light`` and ``clutter``: 0 even and unchanging, bare ... 1 one lamp that wanders, much lies and hangs
    about. ``cable``: while a file of this name is there, the camera is unplugged.
    """

    seed: int = 1
    board: Path | None = None
    depth: bool = True
    markers: bool = True
    burn_frame: bool = False
    noise: Annotated[float, Field(ge=0, le=100)] = 2.0
    blur_px: Annotated[float, Field(ge=0, le=20)] = 0.6
    focal_px: Annotated[float, Field(gt=0)] | None = None
    light: Annotated[float, Field(ge=0, le=1)] = 1.0
    clutter: Annotated[float, Field(ge=0, le=1)] = 1.0
    distortion: tuple[Annotated[float, Field(allow_inf_nan=False)], ...] = (0.08, -0.15, 0.0005, -0.0005, 0.05)
    distance_mm: Annotated[float, Field(gt=0)] | None = None
    speed: Annotated[float, Field(ge=0, le=100)] = 1.0
    view: Annotated[float, Field(ge=-180, le=180)] = 0.0
    frames: Annotated[int, Field(ge=1)] | None = None
    prerendered: Annotated[int, Field(ge=0, le=10000)] = 0
    pace: Literal["fps", "consumer"] = "fps"
    cable: Path | None = None

    @field_validator("distortion")
    @classmethod
    def _of_cv2_length(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) not in _DISTORTION_LENGTHS:
            lengths = ", ".join(map(str, _DISTORTION_LENGTHS))
            raise ValueError(f"k1, k2, p1, p2, k3, ...: {lengths} numbers, not {len(value)}")
        return value


class FilesOptions(Section):
    """Keys of ``driver: files``. ``path`` is a folder, a glob, a video or a bag; ``depth_path`` a folder of depth PNGs.

    The topics are those of a bag.
    """

    path: Path
    depth_path: Path | None = None
    topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    depth_unit_mm: PositiveMm = 1.0
    loop: bool = False
    begin: Literal["on_start", "at_start"] = "on_start"
    pace: Literal["fps", "consumer"] = "fps"


class Kinect2Options(Section):
    """Keys of ``driver: kinect2``. ``serial`` or the first found; ``pipeline`` computes the depth."""

    serial: str | None = None
    pipeline: Literal["cpu", "opengl", "opencl"] = "cpu"


class WebcamOptions(Section):
    """Keys of ``driver: webcam``. One of ``path``, ``index``, ``serial`` says which, none = the first one.

    ``serial``: a name of /dev/v4l/by-id or a part that only one has. ``buffers``: the kernel's; with one many cameras
    give half their rate, since a picture that begins while it is read has nowhere to go. ``controls``: any other
    setting by the name that ``v4l2-ctl -l`` shows.
    """

    path: Path | None = None
    index: Annotated[int, Field(ge=0, le=255)] | None = None
    serial: Annotated[str, Field(min_length=1)] | None = None
    pixel_format: Literal["MJPG", "YUYV", "UYVY", "GREY"] = "MJPG"
    buffers: Annotated[int, Field(ge=1, le=10)] = 2
    exposure_ms: Annotated[float, Field(gt=0, le=10000)] | None = None
    gain: int | None = None
    white_balance_k: Annotated[int, Field(gt=0)] | None = None
    focus: int | None = None
    controls: dict[str, int] = {}

    @field_validator("index", "serial")
    @classmethod
    def _names_it_alone(cls, value: object, info: ValidationInfo) -> object:
        others = [key for key in ("path", "index") if key != info.field_name and info.data.get(key) is not None]
        if value is not None and others:
            raise PydanticCustomError("said", "{key} says already which camera it is; keep one", {"key": others[0]})
        return value


class StreamOptions(Section):
    """Keys of ``driver: stream``. ``url`` may hold a login, which is never shown nor stored.

    ``transport`` is that of RTSP. ``timeout_s``: a camera that gives nothing for so long is lost, and opened again.
    """

    url: str
    transport: Literal["tcp", "udp"] = "tcp"
    timeout_s: Annotated[float, Field(ge=0.5, le=60)] = 5.0

    @field_validator("url")
    @classmethod
    def _is_an_address(cls, value: str) -> str:
        fault = address_fault(value)
        if fault:
            raise PydanticCustomError("said", "is no address of a stream: {fault}", {"fault": fault})
        return value


DRIVER_OPTIONS: dict[str, type[Section]] = {
    "synthetic": SyntheticOptions,
    "files": FilesOptions,
    "kinect2": Kinect2Options,
    "webcam": WebcamOptions,
    "stream": StreamOptions,
    "realsense": RealSenseOptions,
}
"""Built-in drivers and the model of their keys; other drivers check their own."""
