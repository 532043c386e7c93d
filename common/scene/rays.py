"""The viewing ray of every pixel of a camera, computed once, and the pixels that a polygon can touch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel

Array = NDArray[np.float64]
Plane = NDArray[np.float32]
NEAR_MM = 10.0
"""Polygons are cut off at this distance in front of the camera's plane."""
_SAMPLES_PER_EDGE = 8
_STEPS = np.linspace(0.0, 1.0, _SAMPLES_PER_EDGE, endpoint=False)[None, :, None]


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of pixels, ``x1`` and ``y1`` exclusive."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Indexes a (H, W, ...) array."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def inside(self, outer: Region) -> tuple[slice, slice]:
        """Indexes an array that holds just ``outer``, which must contain this region."""
        return slice(self.y0 - outer.y0, self.y1 - outer.y0), slice(self.x0 - outer.x0, self.x1 - outer.x0)

    def grown(self, pixels: int, within: Region) -> Region:
        """Widened on each side, cut at ``within``."""
        return Region(
            max(self.x0 - pixels, within.x0),
            max(self.y0 - pixels, within.y0),
            min(self.x1 + pixels, within.x1),
            min(self.y1 + pixels, within.y1),
        )

    def overlap(self, other: Region) -> Region | None:
        """What both have in common, None if nothing."""
        cut = self.grown(0, other)
        return cut if cut.x0 < cut.x1 and cut.y0 < cut.y1 else None

    def union(self, other: Region) -> Region:
        """The smallest rectangle that holds both."""
        return Region(min(self.x0, other.x0), min(self.y0, other.y0), max(self.x1, other.x1), max(self.y1, other.y1))


@dataclass(frozen=True, eq=False)
class PixelRays:
    """``x`` and ``y`` (H, W) float32: the ray (x, y, 1) in the camera frame through each pixel's centre.

    float32 resolves 5e-5 px of a picture 1280 wide. Cameras must see less than 180 degrees.
    """

    camera: CameraModel
    x: Plane
    y: Plane

    @classmethod
    def of(cls, camera: CameraModel) -> PixelRays:
        """Undistort every pixel of the camera once (about 0.3 s for 1280x720)."""
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
        rays: Array = camera.normalise(np.column_stack([columns.ravel(), rows.ravel()]))
        shape = (camera.height, camera.width)
        return cls(
            camera,
            np.ascontiguousarray(rays[:, 0].reshape(shape), dtype=np.float32),
            np.ascontiguousarray(rays[:, 1].reshape(shape), dtype=np.float32),
        )

    @property
    def picture(self) -> Region:
        """The whole picture."""
        return Region(0, 0, self.camera.width, self.camera.height)

    def shifted(self, du: float, dv: float) -> PixelRays:
        """The rays through points beside the pixels' centres; offsets in px, below 1."""
        (x_u, x_v), (y_u, y_v) = self._slopes
        return PixelRays(self.camera, self.x + du * x_u + dv * x_v, self.y + du * y_u + dv * y_v)

    def jacobian(self, pixel: Array) -> Array:
        """d(x, y) / d(u, v) as a (2, 2) matrix, at the pixel of the picture nearest to ``pixel`` (2,)."""
        u, v = (
            round(min(max(float(at), 1.0), size - 2.0)) if math.isfinite(at) else 1  # behind the camera
            for at, size in zip(pixel, (self.camera.width, self.camera.height), strict=True)
        )
        x, y = self.x, self.y
        return np.array(
            [
                [(float(x[v, u + 1]) - float(x[v, u - 1])) / 2, (float(x[v + 1, u]) - float(x[v - 1, u])) / 2],
                [(float(y[v, u + 1]) - float(y[v, u - 1])) / 2, (float(y[v + 1, u]) - float(y[v - 1, u])) / 2],
            ]
        )

    def form(self, weights: Array, region: Region) -> Plane:
        """``w0 x + w1 y + w2`` for each pixel of the region, float32."""
        rows, columns = region.slices
        a, b, c = (float(w) for w in weights)
        return np.asarray(cv2.addWeighted(self.x[rows, columns], a, self.y[rows, columns], b, c), dtype=np.float32)

    def region_of(self, polygon: Array, margin: int = 2) -> Region | None:
        """The pixels that a convex polygon (N, 3) in the camera frame can touch, None if none."""
        cut = polygon if (polygon[:, 2] >= NEAR_MM).all() else clip_near(polygon)
        if len(cut) < 3:
            return None
        steps = _STEPS
        following = cut[[*range(1, len(cut)), 0]]
        outline = (cut[:, None, :] * (1 - steps) + following[:, None, :] * steps).reshape(-1, 3)
        pixels, _ = self.camera.project(outline)
        # Between two samples a distorted edge bulges by far less than the margin.
        limit = 10.0 * max(self.camera.width, self.camera.height)
        low = np.clip(np.floor(pixels.min(axis=0)), -limit, limit).astype(int) - margin
        high = np.clip(np.ceil(pixels.max(axis=0)), -limit, limit).astype(int) + margin + 1
        return Region(int(low[0]), int(low[1]), int(high[0]), int(high[1])).overlap(self.picture)

    @cached_property
    def _slopes(self) -> tuple[tuple[Plane, Plane], tuple[Plane, Plane]]:
        def slope(plane: Plane, axis: int) -> Plane:
            return np.asarray(np.gradient(plane, axis=axis), dtype=np.float32)

        return (slope(self.x, 1), slope(self.x, 0)), (slope(self.y, 1), slope(self.y, 0))


def clip_near(polygon: Array) -> Array:
    """The part (M, 3) of a convex polygon (N, 3) in the camera frame with z >= ``NEAR_MM``; M may be 0."""
    kept: list[Array] = []
    for here, following in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if here[2] >= NEAR_MM:
            kept.append(here)
        if (here[2] >= NEAR_MM) != (following[2] >= NEAR_MM):
            share = (NEAR_MM - here[2]) / (following[2] - here[2])
            kept.append(here + share * (following - here))
    return np.array(kept).reshape(-1, 3)
