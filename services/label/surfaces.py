"""Where on which side a region to erase lies: what a fill may look at, and how it stands to the camera. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import ErasedPolygon, Quad
from services.label.visibility import viewing_angle
from services.label.windows import clip_near

Array = NDArray[np.float64]
_SQUARE = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
_WORST_CONDITION = 1e9
"""Of a homography; that of a marker on a side, from mm to pixels, has some 1e6."""
_ALONG = np.linspace(0.0, 1.0, 8, endpoint=False)


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


def surface_of_pose(
    box: Box, side: BoxSide, marker: MarkerOnSide, pose: Pose, camera: CameraModel, others: list[tuple[Box, Pose]]
) -> Surface | None:
    """The surface of a configured marker; None where it reaches behind the camera."""
    on_box = box.marker_pose(side, marker)
    # Axes of the side, not of a marker that was stuck on askew: what is printed on a side follows the side.
    frame = pose.after(Pose(box.face_pose(side.face).rotation, on_box.translation))
    half = marker.size_mm / 2 + marker.border_mm
    pixels, front = camera.project(frame.apply(_SQUARE * half))
    if not front.all():
        return None
    to_pixel = _homography(_SQUARE[:, :2] * half, pixels)
    if to_pixel is None:
        return None
    distance = float(np.linalg.norm(frame.translation))
    return Surface(
        to_pixel=to_pixel,
        outline=_outline(pose.apply(box.face_polygon(side.face)), camera),
        beside=_other_sides(box, side, pose, camera),
        nearer=tuple(
            outline
            for other, at in others
            if np.linalg.norm(at.translation) < np.linalg.norm(pose.translation)
            and (outline := _hull_of(other, at, camera)) is not None
        ),
        depth_row=np.array([frame.rotation[2, 0], frame.rotation[2, 1], frame.translation[2]]),
        distance_mm=distance,
    )


def surface_of_corners(corners: Quad) -> Surface | None:
    """The surface of a marker of which only the corners (TL TR BR BL, px) are known."""
    to_pixel = _homography(_SQUARE[:, :2], np.array(corners, dtype=np.float64))
    return None if to_pixel is None else Surface(to_pixel)


def _homography(plane: Array, pixels: Array) -> Array | None:
    if not np.isfinite(pixels).all() or abs(cv2.contourArea(pixels.astype(np.float32))) < 1.0:
        return None
    found = cv2.getPerspectiveTransform(plane.astype(np.float32), pixels.astype(np.float32))
    if not np.isfinite(found).all() or np.linalg.cond(found) > _WORST_CONDITION:
        return None
    return np.asarray(found, dtype=np.float64)


def _outline(corners: Array, camera: CameraModel) -> Array | None:
    """The outline (N, 2) px of a polygon (M, 3) in the camera frame, with points along its edges for the lens."""
    cut = clip_near(corners)
    if len(cut) < 3:
        return None
    following = np.roll(cut, -1, axis=0)
    steps = cut[:, None, :] + (following - cut)[:, None, :] * _ALONG[None, :, None]
    pixels, front = camera.project(steps.reshape(-1, 3))
    return np.clip(pixels[front], -3e4, 3e4) if front.sum() >= 3 else None


def _other_sides(box: Box, side: BoxSide, pose: Pose, camera: CameraModel) -> tuple[Array, ...]:
    seen = (
        _outline(pose.apply(box.face_polygon(face)), camera)
        for face in FACES
        if face != side.face and viewing_angle(pose, face, box.face_pose(face).translation) < 90.0
    )
    return tuple(outline for outline in seen if outline is not None)


def _hull_of(box: Box, pose: Pose, camera: CameraModel) -> Array | None:
    pixels, front = camera.project(pose.apply(box.corners))
    if front.sum() < 3:
        return None
    bounded = np.clip(pixels[front], -3e4, 3e4).astype(np.float32)
    return np.asarray(cv2.convexHull(bounded), dtype=np.float64).reshape(-1, 2)
