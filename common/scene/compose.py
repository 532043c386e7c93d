"""Puts drawn objects into the picture of the empty scene: only the pixels that objects touch are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.raster import Patch, Picture
from common.scene.rays import PixelRays, Region

Depth = NDArray[np.uint16]
Draw = Callable[[Patch, PixelRays], None]


class Composer:
    """The empty scene of one camera, and how regions of it are drawn over.

    ``passes``: each pixel is the mean of passes x passes samples of the blurred scene; 1 relies on analytic edges
    alone and blurs the finished pixels.
    """

    def __init__(self, rays: PixelRays, empty: Picture, empty_depth: Depth, light: Picture, passes: int) -> None:
        self.rays = rays
        self._empty = empty
        self._empty_depth = empty_depth
        self._light = light
        self._passes = passes
        self._blurred: tuple[float, Picture] = (0.0, empty)

    def start(self, blur_px: float, *, depth: bool) -> tuple[Picture, Depth | None]:
        """A fresh picture of the empty scene as a lens of this blur sees it, and its depth."""
        if self._blurred[0] != blur_px:
            self._blurred = (blur_px, blurred(self._empty, blur_px))
        return self._blurred[1].copy(), self._empty_depth.copy() if depth else None

    def draw(self, bgr: Picture, depth: Depth | None, region: Region, blur_px: float, draw: Draw) -> None:
        """Draw into a region (what is touched) of a started picture, blurred together with what is behind it."""
        reach = reach_of(blur_px)
        drawn = region.grown(2 * reach, self.rays.picture)
        patch_depth = depth[drawn.slices] if depth is not None else None
        if self._passes == 1:
            patch = self._patch(drawn, patch_depth)
            draw(patch, self.rays)
            done = blurred(patch.bgr, blur_px)
        else:
            done = self._sampled(drawn, blur_px, draw)
            if patch_depth is not None:
                draw(self._patch(drawn, patch_depth), self.rays)
        put = region.grown(reach, self.rays.picture)
        bgr[put.slices] = done[put.inside(drawn)]

    def _patch(self, region: Region, depth: Depth | None, pixel: float = 1.0) -> Patch:
        return Patch(region, self._empty[region.slices].copy(), depth, self._light, pixel)

    def _sampled(self, region: Region, blur_px: float, draw: Draw) -> Picture:
        """A region as a sensor sees it: the lens blurs first, and each pixel collects what then falls on it.

        A blur of finished pixels makes profiles of edges that no lens makes; measured on them, the best of
        corners seem to be off by some 0.02 px.
        """
        fine = self._passes
        high, wide = region.y1 - region.y0, region.x1 - region.x0
        samples = np.empty((high * fine, wide * fine, 3), np.uint8)
        offsets = (np.arange(fine) + 0.5) / fine - 0.5
        for row, dv in enumerate(offsets):
            for column, du in enumerate(offsets):
                patch = self._patch(region, None, 1.0 / fine)
                draw(patch, self.rays.shifted(float(du), float(dv)))
                samples[row::fine, column::fine] = patch.bgr
        seen = blurred(samples, blur_px * fine)
        return np.asarray(cv2.resize(seen, (wide, high), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def blurred(picture: Picture, sigma: float) -> Picture:
    """A picture behind a Gaussian lens blur of ``sigma`` px; the picture itself for 0."""
    if sigma <= 0:
        return picture
    size = 2 * reach_of(sigma) + 1
    return np.asarray(cv2.GaussianBlur(picture, (size, size), sigma), dtype=np.uint8)


def reach_of(sigma: float) -> int:
    """How many pixels away ``blurred`` still mixes."""
    return ceil(3 * sigma) if sigma > 0 else 0


def merged(regions: Iterable[tuple[str, Region]], apart: int) -> list[tuple[frozenset[str], Region]]:
    """Join the regions of names until no two are nearer than ``apart`` px: overlapping objects are drawn together."""
    groups: list[tuple[frozenset[str], Region]] = []
    for name, region in regions:
        names = frozenset([name])
        while near := next((group for group in groups if _near(group[1], region, apart)), None):
            groups.remove(near)
            names, region = names | near[0], region.union(near[1])  # noqa: PLW2901 - it grows while it eats
        groups.append((names, region))
    return groups


def _near(a: Region, b: Region, apart: int) -> bool:
    return a.x0 - apart < b.x1 and b.x0 - apart < a.x1 and a.y0 - apart < b.y1 and b.y0 - apart < a.y1
