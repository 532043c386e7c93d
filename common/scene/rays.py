"""The viewing ray of every pixel of a camera, computed once, and the pixels that a polygon can touch."""

from __future__ import annotations

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
_BAND = 16
_SIDEWAYS = 1e3
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
        """Undistort every pixel of the camera once (some tenths of a second for 1280x720)."""
        x = np.empty((camera.height, camera.width), np.float32)
        y = np.empty_like(x)
        columns = np.arange(camera.width, dtype=np.float64)
        # Band by band: cv2 needs hundreds of bytes for each point.
        for top in range(0, camera.height, _BAND):
            rows = np.arange(top, min(top + _BAND, camera.height), dtype=np.float64)
            pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
            rays = camera.normalise(pixels)
            lost = ~np.isfinite(rays).all(axis=1)
            if lost.any():
                # No ray leads to this pixel: let it look far to the side, past everything.
                outwards = pixels[lost] - camera.matrix[:2, 2]
                rays[lost] = _SIDEWAYS * outwards / np.maximum(np.linalg.norm(outwards, axis=1), 1e-9)[:, None]
            x[top : top + len(rows)], y[top : top + len(rows)] = rays.T.reshape(2, len(rows), camera.width)
        return cls(camera, x, y)

    @property
    def picture(self) -> Region:
        """The whole picture."""
        return Region(0, 0, self.camera.width, self.camera.height)

    def shifted(self, du: float, dv: float) -> PixelRays:
        """The rays through points beside the pixels' centres; offsets in px, below 1."""
        (x_u, x_v), (y_u, y_v) = self._slopes
        return PixelRays(self.camera, self.x + du * x_u + dv * x_v, self.y + du * y_u + dv * y_v)

    def jacobians(self, pixels: Array) -> Array:
        """d(x, y) / d(u, v) as (N, 2, 2), each at the pixel of the picture nearest to ``pixels`` (N, 2)."""
        limits = np.array([self.camera.width - 2, self.camera.height - 2])
        # A point behind the camera has no pixel (NaN); its shape is cut off before it.
        near = np.clip(np.nan_to_num(pixels, nan=1.0), 1, limits)
        u, v = np.rint(near).astype(np.intp).T
        along_u = np.stack([plane[v, u + 1].astype(np.float64) - plane[v, u - 1] for plane in (self.x, self.y)], axis=1)
        along_v = np.stack([plane[v + 1, u].astype(np.float64) - plane[v - 1, u] for plane in (self.x, self.y)], axis=1)
        jacobians: Array = np.stack([along_u, along_v], axis=2) / 2
        return jacobians

    def form(self, weights: Array, region: Region) -> Plane:
        """``w0 x + w1 y + w2`` for each pixel of the region, float32."""
        rows, columns = region.slices
        a, b, c = (float(w) for w in weights)
        return np.asarray(cv2.addWeighted(self.x[rows, columns], a, self.y[rows, columns], b, c), dtype=np.float32)

    def region_of(self, polygon: Array, margin: int = 2) -> Region | None:
        """The pixels that a convex polygon (N, 3) in the camera frame can touch, None if none."""
        cut = clip_near(polygon)
        if len(cut) < 3:
            return None
        following = cut[[*range(1, len(cut)), 0]]
        outline = (cut[:, None, :] * (1 - _STEPS) + following[:, None, :] * _STEPS).reshape(-1, 3)
        pixels, _ = self.camera.project(outline)
        return self.around(pixels, margin)

    def around(self, pixels: Array, margin: int) -> Region | None:
        """The part of the picture around points (N, 2) px; a distorted edge bulges by less than the margin."""
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
