"""Rectangles as a camera sees them: everything about them that is the same for all their pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.geometry import MARKER_CORNERS, Pose
from common.scene.rays import NEAR_MM, PixelRays, Region

Array = NDArray[np.float64]
_SAMPLES_PER_EDGE = 8
_STEPS = np.linspace(0.0, 1.0, _SAMPLES_PER_EDGE, endpoint=False)[:, None]
_MARGIN_PX = 2
_FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangle in space: its frame (centre, x right, y up, z to the viewer) to the camera frame, size in mm."""

    pose: Pose
    width_mm: float
    height_mm: float

    @cached_property
    def corners(self) -> Array:
        """TL TR BR BL (4, 3) in the camera frame."""
        return self.pose.apply(MARKER_CORNERS * np.array([self.width_mm, self.height_mm, 0.0]))

    @cached_property
    def cosine(self) -> float:
        """Cosine of the angle between its normal and the direction from its centre to the camera."""
        distance = float(np.linalg.norm(self.pose.translation))
        return -float(self.pose.rotation[:, 2] @ self.pose.translation) / max(distance, 1e-9)

    @property
    def facing(self) -> bool:
        """Whether its front is towards the camera."""
        return self.cosine > 0.0


@dataclass(frozen=True, eq=False)
class Seen:
    """A rectangle that faces the camera and touches the picture.

    ``region``: the pixels that it can touch. ``inverse`` (3, 3): turns a ray (x, y, 1) into (x, y, 1) / z with the
    point (x, y) mm that it meets in the rectangle's frame and that point's depth z. ``edges`` (4, 3) top right bottom
    left: ``e0 x + e1 y + e2`` is a ray's distance from the edge in px, positive inside (exact on the edge, and near
    enough beside it); ``normals`` (4, 2): the inward unit normals in the picture there. ``footprint``: how many mm of
    the rectangle's x and y axes a pixel in the middle covers.
    """

    shape: Rectangle
    region: Region
    inverse: Array
    edges: Array
    normals: Array
    footprint: tuple[float, float]


def look_at(rays: PixelRays, shapes: Sequence[Rectangle]) -> list[Seen | None]:
    """How the camera sees each of the shapes; None for those that it doesn't see."""
    facing = [number for number, shape in enumerate(shapes) if shape.facing]
    found: list[Seen | None] = [None] * len(shapes)
    if not facing:
        return found
    corners = np.array([shapes[number].corners for number in facing])
    ends = corners[:, [1, 2, 3, 0]]
    outlines = corners[:, :, None] * (1 - _STEPS) + ends[:, :, None] * _STEPS
    pixels, _ = rays.camera.project(outlines.reshape(-1, 3))
    outlined = pixels.reshape(len(facing), 4, _SAMPLES_PER_EDGE, 2)
    edges, normals = _edges(rays, corners, ends, outlined[:, :, _SAMPLES_PER_EDGE // 2])
    # Columns of the homography: a point (x, y) of the plane lies on the ray of H (x, y, 1).
    poses = [shapes[number].pose for number in facing]
    inverses = np.linalg.inv(
        np.array([[p.rotation[:, 0], p.rotation[:, 1], p.translation] for p in poses]).swapaxes(1, 2)
    )
    regions = [
        rays.region_of(corners[at])
        if (corners[at, :, 2] < NEAR_MM).any()
        else rays.around(outlined[at].reshape(-1, 2), _MARGIN_PX)
        for at in range(len(facing))
    ]
    footprints = _footprints(rays, inverses, [region or rays.picture for region in regions])
    for at, number in enumerate(facing):
        region = regions[at]
        if region is not None:
            across, down = footprints[at].tolist()
            found[number] = Seen(shapes[number], region, inverses[at], edges[at], normals[at], (across, down))
    return found


def slopes_at(rays: PixelRays, seen: Seen, points: Array) -> Array:
    """By how many mm x and y of the rectangle's frame change from a pixel to the next one right, down.

    At points (N, 2) mm of its plane; (N, 2, 2).
    """
    homogeneous = np.column_stack([points, np.ones(len(points))])
    in_camera = homogeneous @ np.linalg.inv(seen.inverse).T
    pixels, _ = rays.camera.project(in_camera)
    along = (seen.inverse[:2, :2] - points[:, :, None] * seen.inverse[2, :2]) * in_camera[:, 2, None, None]
    slopes: Array = along @ rays.jacobians(pixels)
    return slopes


def _edges(rays: PixelRays, starts: Array, ends: Array, middles: Array) -> tuple[Array, Array]:
    """The lines (N, 4, 3) through the edges as the camera sees them, and their normals (N, 4, 2) in the picture.

    Scale and normals are those at the edges' middles (N, 4, 2).
    """
    planes = np.cross(starts, ends)
    planes *= np.sign(planes @ starts.mean(axis=1)[:, :, None])
    slopes = np.einsum("nei,neij->nej", planes[:, :, :2], rays.jacobians(middles.reshape(-1, 2)).reshape(-1, 4, 2, 2))
    steep = np.maximum(np.hypot(slopes[:, :, 0], slopes[:, :, 1]), _FLAT)[:, :, None]
    return planes / steep, slopes / steep


def _footprints(rays: PixelRays, inverses: Array, regions: list[Region]) -> Array:
    """What a pixel in the middle of each region covers along the plane's axes, (N, 2) mm."""
    middles = np.array([((r.x0 + r.x1) // 2, (r.y0 + r.y1) // 2) for r in regions])
    u, v = middles.T
    through = np.stack([rays.x[v, u], rays.y[v, u], np.ones(len(u), np.float32)], axis=1).astype(np.float64)
    met = np.einsum("nij,nj->ni", inverses, through)
    scale = np.where(np.abs(met[:, 2]) < _FLAT, _FLAT, met[:, 2])
    at = met[:, :2] / scale[:, None]
    along = (inverses[:, :2, :2] - at[:, :, None] * inverses[:, 2:, :2]) / scale[:, None, None]
    footprints: Array = np.linalg.norm(along @ rays.jacobians(middles), axis=2)
    return footprints
