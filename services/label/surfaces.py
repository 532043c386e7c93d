"""Where on which side a region to erase lies: what a fill may look at, and how it stands to the camera. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import ErasedPolygon, FaceName, Quad
from services.label.visibility import viewing_angle
from services.label.windows import along_sides, clip_near

Array = NDArray[np.float64]
_SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
_WORST_CONDITION = 1e9
"""Of a homography; that of a marker on a side, from mm to pixels, has some 1e6."""
_ALONG = 8
"""Points along each edge of an outline: through a lens, straight edges are bent."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The plane that carries a marker, as the camera sees it.

    ``to_pixel`` (3, 3) takes the plane's own coordinates (origin in the marker, axes along the side's edges where
    they are known, any unit) to pixels; exact in the marker's neighbourhood, where a lens bends next to nothing.
    ``outline`` (N, 2) px is the side's edge in the picture, None where no pose tells; ``beside`` are those of the
    object's other sides that are seen, ``nearer`` the outlines of objects that may stand before it.
    ``depth_row`` (3,): a point (x, y) of the plane lies at z = row @ (x, y, 1) mm; None without a pose.
    ``distance_mm`` orders surfaces from near to far.
    """

    to_pixel: Array
    outline: Array | None = None
    beside: tuple[Array, ...] = ()
    nearer: tuple[Array, ...] = ()
    depth_row: Array | None = None
    distance_mm: float = float("inf")


@dataclass(frozen=True, eq=False)
class Region:
    """A polygon to erase, and the surface it lies on (None: nothing is known of it)."""

    polygon: ErasedPolygon
    surface: Surface | None = None


@dataclass(frozen=True, eq=False)
class PlacedBox:
    """A box where a pose puts it, and what the camera sees of it; looked at once, however many markers it carries."""

    box: Box
    pose: Pose
    camera: CameraModel

    def outline(self, face: FaceName) -> Array | None:
        """A face's edge (N, 2) px, also of one that is turned away; None where too little lies before the camera."""
        if face not in self._outlines:
            corners = self.pose.apply(self.box.face_polygon(face))
            self._outlines[face] = _outline(corners, self.camera)
        return self._outlines[face]

    def beside(self, face: FaceName) -> tuple[Array, ...]:
        """The outlines of the other faces that are turned to the camera."""
        seen = (self.outline(other) for other in self._turned_here if other != face)
        return tuple(outline for outline in seen if outline is not None)

    @cached_property
    def hull(self) -> Array | None:
        """The outline (N, 2) px of all of it."""
        pixels, front = self.camera.project(self.pose.apply(self.box.corners))
        if front.sum() < 3:
            return None
        bounded = np.clip(pixels[front], -3e4, 3e4).astype(np.float32)
        return np.asarray(cv2.convexHull(bounded), dtype=np.float64).reshape(-1, 2)

    @cached_property
    def distance_mm(self) -> float:
        """Of its origin."""
        return math.hypot(*self.pose.translation)

    @cached_property
    def _outlines(self) -> dict[FaceName, Array | None]:
        return {}

    @cached_property
    def _turned_here(self) -> tuple[FaceName, ...]:
        box, pose = self.box, self.pose
        return tuple(face for face in FACES if viewing_angle(pose, face, box.face_pose(face).translation) < 90.0)


def surface_of_pose(
    placed: PlacedBox, side: BoxSide, marker: MarkerOnSide, others: Sequence[PlacedBox] = ()
) -> Surface | None:
    """The surface of a configured marker; None where it reaches behind the camera."""
    box = placed.box
    # Axes of the side, not of a marker that was stuck on askew: what is printed on a side follows the side.
    frame = placed.pose.after(Pose(box.face_pose(side.face).rotation, box.marker_pose(side, marker).translation))
    half = marker.size_mm / 2 + marker.border_mm
    pixels, front = placed.camera.project(frame.apply(_SQUARE * half))
    if not front.all():
        return None
    to_pixel = _homography(_SQUARE[:, :2] * half, pixels)
    if to_pixel is None:
        return None
    before = (other.hull for other in others if other.distance_mm < placed.distance_mm)
    return Surface(
        to_pixel=to_pixel,
        outline=placed.outline(side.face),
        beside=placed.beside(side.face),
        nearer=tuple(hull for hull in before if hull is not None),
        depth_row=np.array([frame.rotation[2, 0], frame.rotation[2, 1], frame.translation[2]]),
        distance_mm=math.hypot(*frame.translation),
    )


def surface_of_corners(corners: Quad) -> Surface | None:
    """The surface of a marker of which only the corners (TL TR BR BL, px) are known."""
    to_pixel = _homography(_SQUARE[:, :2], np.array(corners, dtype=np.float64))
    return None if to_pixel is None else Surface(to_pixel)


def _homography(plane: Array, pixels: Array) -> Array | None:
    if not np.isfinite(pixels).all() or abs(cv2.contourArea(pixels.astype(np.float32))) < 1.0:
        return None
    found = cv2.getPerspectiveTransform(plane.astype(np.float32), pixels.astype(np.float32))
    if not np.isfinite(found).all():
        return None
    scales, _, _ = cv2.SVDecomp(found, flags=cv2.SVD_NO_UV)
    if not float(scales[0, 0]) <= _WORST_CONDITION * float(scales[2, 0]):
        return None
    return np.asarray(found, dtype=np.float64)


def _outline(corners: Array, camera: CameraModel) -> Array | None:
    """The outline (N, 2) px of a polygon (M, 3) in the camera frame, with points along its edges for the lens."""
    cut = clip_near(corners)
    if len(cut) < 3:
        return None
    pixels, front = camera.project(along_sides(cut, _ALONG))
    return np.clip(pixels[front], -3e4, 3e4) if front.sum() >= 3 else None
