"""What a label was made from beside its pixels: the markers as they were detected, and what other frames said.

Kept in the label where the original picture is kept too, so that the label can be made again. Numbers are written
with all their digits: read back they are the same bits. Millimetres, radians, monotonic ns; object to camera frame.
"""

from __future__ import annotations

from common.parts import Matrix3, Part, Quad, Vector3


class DetectedMarker(Part):
    """A marker: id and corners TL TR BR BL in the marker's own frame, px, integer = pixel centre.

    ``kind`` says how the corners were found: ``contour``, ``subpix``, ``edges``, ``apriltag``, ``photometric``.
    """

    id: int
    corners: Quad
    kind: str


class KeptPose(Part):
    """An object's pose: rotation (3x3) and translation (mm)."""

    rotation: Matrix3
    translation_mm: Vector3


class KeptPrior(Part):
    """The pose of an object in a frame just before, and how much it counts between two that fit alike."""

    object: str
    pose: KeptPose
    evidence: float
    confirmed: bool


class KeptSighting(Part):
    """The pose of an object in another frame; ``covariance`` (6x6, row by row) of a rotation (rad) and a shift (mm)."""

    time_ns: int
    pose: KeptPose
    covariance: tuple[float, ...]


class KeptExpected(Part):
    """An object that other frames showed: at the latest ``before`` this one (``time_ns``), ``earlier``, ``after``."""

    object: str
    time_ns: int
    before: KeptSighting
    earlier: KeptSighting | None = None
    after: KeptSighting | None = None


class MadeFrom(Part):
    """The detector's ``markers`` (coarse corners) and what was known from other frames when the label was made.

    ``steady``: the frame is one of a stream; a picture that stands alone (False) has no other frames.
    """

    markers: tuple[DetectedMarker, ...]
    steady: bool
    previous: tuple[KeptPrior, ...] = ()
    expected: tuple[KeptExpected, ...] = ()
