"""The cuboid object: its faces, corners and the markers on it.

Object frame: origin at the box's centre, X right, Y away, Z up, as seen by one who looks at the front; mm.
Marker frame: centre of the black square, x right, y up, z out of the paper towards the viewer; mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.geometry.pose import Pose
from common.labels import FaceName

Array = NDArray[np.float64]
Axis = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Face:
    """A face of the box: outward normal, and right and up as its viewer sees them (object frame).

    ``axes`` are the indices into (width, height, depth) of the face's own width, height and depth.
    """

    name: FaceName
    normal: Axis
    right: Axis
    up: Axis
    axes: tuple[int, int, int]


_W, _H, _D = 0, 1, 2
FACES: dict[FaceName, Face] = {
    face.name: face
    for face in (
        Face("front", (0, -1, 0), (1, 0, 0), (0, 0, 1), (_W, _H, _D)),
        Face("back", (0, 1, 0), (-1, 0, 0), (0, 0, 1), (_W, _H, _D)),
        Face("left", (-1, 0, 0), (0, -1, 0), (0, 0, 1), (_D, _H, _W)),
        Face("right", (1, 0, 0), (0, 1, 0), (0, 0, 1), (_D, _H, _W)),
        Face("top", (0, 0, 1), (1, 0, 0), (0, 1, 0), (_W, _D, _H)),
        Face("bottom", (0, 0, -1), (1, 0, 0), (0, -1, 0), (_W, _D, _H)),
    )
}

CORNER_NAMES: tuple[str, ...] = tuple(
    f"{face}_{row}" for face in ("front", "back") for row in ("top_left", "top_right", "bottom_right", "bottom_left")
)
_CORNER_SIGNS = np.array(
    [(x, y, z) for y in (-1, 1) for x, z in ((-1, 1), (1, 1), (1, -1), (-1, -1))], dtype=np.float64
)
EDGES: tuple[tuple[int, int], ...] = (
    *((i, (i + 1) % 4) for i in range(4)),
    *((4 + i, 4 + (i + 1) % 4) for i in range(4)),
    *((i, i + 4) for i in range(4)),
)
"""The box's twelve edges as pairs of corner indices."""

MARKER_CORNERS = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
"""TL TR BR BL of a marker of size 1 in its own frame."""


def marker_points(size_mm: float) -> Array:
    """The corners (4, 3) TL TR BR BL of a marker with a black square of ``size_mm``, in the marker frame."""
    return np.asarray(MARKER_CORNERS * size_mm)


@dataclass(frozen=True, slots=True)
class MarkerOnSide:
    """A marker on a side. ``offset_mm``: right, up, out from the side's centre, in the *side's* axes."""

    id: int
    size_mm: float
    border_mm: float = 0.0
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_deg: float = 0.0

    @property
    def margin(self) -> float | None:
        """The white border as a share of the black square's side; None where the rig gives none."""
        return self.border_mm / self.size_mm if self.border_mm > 0 else None


@dataclass(frozen=True, slots=True)
class BoxSide:
    """A side that carries markers; ``class_name`` is what it is called in labels."""

    class_name: str
    face: FaceName
    markers: tuple[MarkerOnSide, ...]


@dataclass(frozen=True)
class Box:
    """A configured object. ``size_mm`` is width, height, depth as seen from the front."""

    name: str
    type: str
    size_mm: tuple[float, float, float]
    sides: tuple[BoxSide, ...]

    @cached_property
    def corners(self) -> Array:
        """The eight corners (8, 3) in the object frame, in the order of ``CORNER_NAMES``."""
        width, height, depth = self.size_mm
        return np.asarray(_CORNER_SIGNS * np.array([width, depth, height]) / 2)

    def face_size(self, face: FaceName) -> tuple[float, float, float]:
        """Width, height and depth (mm) of the box as the viewer of ``face`` sees them."""
        width, height, depth = (self.size_mm[axis] for axis in FACES[face].axes)
        return width, height, depth

    def face_pose(self, face: FaceName) -> Pose:
        """The side's frame (centre of the face, x right, y up, z outwards) to the object frame."""
        return self._face_poses[face]

    def face_polygon(self, face: FaceName) -> Array:
        """The face's corners (4, 3) TL TR BR BL, as its viewer sees them, in the object frame."""
        kept = self._face_polygons.get(face)
        if kept is None:
            width, height, _ = self.face_size(face)
            kept = self.face_pose(face).apply(MARKER_CORNERS * np.array([width, height, 0.0]))
            kept.flags.writeable = False
            self._face_polygons[face] = kept
        return kept

    @cached_property
    def _face_polygons(self) -> dict[FaceName, Array]:
        return {}

    def marker_pose(self, side: BoxSide, marker: MarkerOnSide) -> Pose:
        """Marker frame to object frame: R = [right up normal] Rz(rotation), t = face centre + offset."""
        kept = self._marker_poses.get((side.face, marker))
        if kept is None:
            kept = self._marker_poses[side.face, marker] = self._place(side.face, marker)
        return kept

    @cached_property
    def _face_poses(self) -> dict[FaceName, Pose]:
        placed = {}
        for name, row in FACES.items():
            rotation = np.array([row.right, row.up, row.normal], dtype=np.float64).T
            placed[name] = Pose(rotation, np.array(row.normal, dtype=np.float64) * self.face_size(name)[2] / 2)
        return placed

    @cached_property
    def _marker_poses(self) -> dict[tuple[FaceName, MarkerOnSide], Pose]:
        return {}

    def _place(self, face: FaceName, marker: MarkerOnSide) -> Pose:
        on_face = self.face_pose(face)
        angle = np.radians(marker.rotation_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
        return on_face.after(Pose(turn, np.array(marker.offset_mm, dtype=np.float64)))

    def marker_corners(self, side: BoxSide, marker: MarkerOnSide, widen_mm: float = 0.0) -> Array:
        """A marker's corners (4, 3) TL TR BR BL in the object frame, widened on each side by ``widen_mm``."""
        if widen_mm:
            return self.marker_pose(side, marker).apply(marker_points(marker.size_mm + 2 * widen_mm))
        kept = self._marker_corners.get((side.face, marker))
        if kept is None:
            kept = self.marker_pose(side, marker).apply(marker_points(marker.size_mm))
            kept.flags.writeable = False
            self._marker_corners[side.face, marker] = kept
        return kept

    @cached_property
    def _marker_corners(self) -> dict[tuple[FaceName, MarkerOnSide], Array]:
        return {}

    def markers(self) -> tuple[tuple[BoxSide, MarkerOnSide], ...]:
        """All markers with the side that carries each."""
        return tuple((side, marker) for side in self.sides for marker in side.markers)
