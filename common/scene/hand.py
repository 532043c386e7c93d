"""A hand before the camera, in colour and depth: what hides a part of an object without being one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel, Pose
from common.scene.compose import blurred
from common.scene.raster import Picture

Array = NDArray[np.float64]
Depth = NDArray[np.uint16]
SKIN = (125.0, 150.0, 205.0)
_CAPSULES = np.array(
    [
        (-28, -20, -28, 25, 17),
        (-10, -25, -10, 30, 18),
        (10, -25, 10, 30, 18),
        (26, -20, 26, 25, 16),
        (-33, 35, -40, 95, 8.5),
        (-12, 40, -14, 115, 9.0),
        (10, 40, 12, 110, 9.0),
        (31, 35, 38, 88, 7.5),
        (-42, -10, -78, 35, 10.0),
        (0, -40, 0, -220, 26),
    ],
    dtype=np.float64,
)
"""Palm, fingers, thumb and forearm: from (x, y) to (x, y) with a radius, mm; y to the fingertips."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A flat hand; ``pose``: its plane (x right, y to the fingertips, the back of the hand at z = 0) to the camera."""

    pose: Pose
    size: float = 1.0

    def covers(self, points: Array) -> NDArray[np.bool_]:
        """Which points (N, 3), camera frame, lie behind the hand."""
        with np.errstate(divide="ignore", invalid="ignore"):
            xy, z = self._meets(points[:, :2] / points[:, 2:])
            return np.asarray((points[:, 2] > 0) & (z > 0) & (z < points[:, 2]) & (self._outside(xy) < 0))

    def draw(self, bgr: Picture, depth: Depth | None, camera: CameraModel, blur_px: float = 0.6) -> None:
        """Draw into a picture (H, W, 3) and its depth (H, W) uint16 mm, in place."""
        reach = np.array([(x, y, 0.0) for x in (-110, 60) for y in (-260, 140)]) * self.size
        corners, front = camera.project(self.pose.apply(reach))
        if not front.all():
            return
        low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 3, 0, (camera.width, camera.height))
        high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 4, 0, (camera.width, camera.height))
        if (low >= high).any():
            return
        columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        xy, z = self._meets(camera.normalise(np.column_stack([columns.ravel(), rows.ravel()])))
        outside = self._outside(xy).reshape(columns.shape)
        per_px = float(self.pose.translation[2]) / float(camera.matrix[0, 0])
        cover = np.clip(0.5 - outside / per_px, 0.0, 1.0).astype(np.float32)
        round_ = np.clip(-outside / (9.0 * self.size), 0.0, 1.0)
        skin = (0.62 + 0.38 * np.sqrt(round_))[..., None] * np.array(SKIN)
        part = bgr[low[1] : high[1], low[0] : high[0]]
        alpha = np.asarray(cv2.GaussianBlur(cover, (0, 0), blur_px) if blur_px > 0 else cover)[..., None]
        part[...] = np.rint(part * (1 - alpha) + blurred(skin.astype(np.uint8), blur_px) * alpha).astype(np.uint8)
        if depth is not None:
            within = (outside < 0) & (z.reshape(columns.shape) > 0)
            target = depth[low[1] : high[1], low[0] : high[0]]
            np.copyto(target, np.rint(z.reshape(columns.shape)).clip(0, 65535).astype(np.uint16), where=within)

    def _meets(self, rays: Array) -> tuple[Array, Array]:
        """Where rays (N, 2) x/z, y/z meet the hand's plane: (N, 2) mm in the plane, (N,) mm along the axis."""
        directions = np.column_stack([rays, np.ones(len(rays))])
        normal = self.pose.rotation[:, 2]
        z = float(normal @ self.pose.translation) / (directions @ normal)
        xyz = directions * z[:, None]
        return np.asarray(((xyz - self.pose.translation) @ self.pose.rotation)[:, :2]), np.asarray(z)

    def _outside(self, xy: Array) -> Array:
        """Distance (mm) of points (N, 2) of the plane from the hand's outline, negative inside."""
        x, y = np.asarray(xy.T, dtype=np.float32)
        nearest = np.full(len(xy), np.inf, dtype=np.float32)
        for x0, y0, x1, y1, radius in (_CAPSULES * self.size).astype(np.float32):
            right, up = x - x0, y - y0
            across, along = x1 - x0, y1 - y0
            share = np.clip((right * across + up * along) / (across * across + along * along), 0.0, 1.0)
            right -= share * across
            up -= share * along
            np.minimum(nearest, np.sqrt(right * right + up * up) - radius, out=nearest)
        return nearest.astype(np.float64)


def noisy_depth(depth: Depth, share: float, random: np.random.Generator) -> Depth:
    """Depth (H, W) uint16 with Gaussian noise of ``share`` of each distance, as of a stereo or structured camera."""
    noise = random.standard_normal(depth.shape, dtype=np.float32)
    return np.asarray(np.rint(depth * (1.0 + np.float32(share) * noise)).clip(0, 65535), dtype=np.uint16)
