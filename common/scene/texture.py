"""Pictures on planes: minified copies for looking at them from afar, and marker patterns that stay exact."""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.coverage import inner_share

Picture = NDArray[np.uint8]
PAD = 8
Values = NDArray[np.float32]
Array = NDArray[np.float64]


class Texture:
    """A BGR picture of a plane of ``width_mm`` x ``height_mm``, row 0 at the top edge.

    Minified copies are made on demand, separately for both axes, because a plane seen at a grazing angle is
    foreshortened in one direction only.
    """

    def __init__(self, picture: Picture, width_mm: float, height_mm: float) -> None:
        self.width_mm = width_mm
        self.height_mm = height_mm
        self._full = picture
        self._levels: dict[tuple[int, int], Picture] = {}

    def level(self, mm_per_pixel: tuple[float, float]) -> Picture:
        """The copy whose texels are about as large as the given pixels' footprint (mm along x, along y).

        Its edges are repeated ``PAD`` texels outwards: pixels on the plane's edge need what is just outside, and
        cv2.remap is twice as slow if it has to make that up itself.
        """
        full = self._full
        texel = (self.width_mm / full.shape[1], self.height_mm / full.shape[0])
        wanted = (
            _halvings(mm_per_pixel[0] / texel[0], full.shape[1]),
            _halvings(mm_per_pixel[1] / texel[1], full.shape[0]),
        )
        if wanted not in self._levels:
            size = (max(full.shape[1] >> wanted[0], 1), max(full.shape[0] >> wanted[1], 1))
            small = cv2.resize(full, size, interpolation=cv2.INTER_AREA)
            padded = cv2.copyMakeBorder(small, PAD, PAD, PAD, PAD, cv2.BORDER_REPLICATE)
            self._levels[wanted] = np.asarray(padded, dtype=np.uint8)
        return self._levels[wanted]


class Pattern:
    """A marker's cells as a function of continuous coordinates, anti-aliased for the pixel's footprint.

    The transition between two cells is a ramp as wide as a pixel's footprint, centred on the very cell
    border; so an edge lies exactly where it belongs whatever the scale, which no texture of texels
    interpolated between their centres can do (and cv2.remap rounds coordinates to 1/32 texel).
    """

    def __init__(self, bitmap: NDArray[np.uint8], *, margin: bool) -> None:
        """``bitmap`` (n, n) 0 black, 1 white, upright; ``margin``: white outside, else the outer cells go on."""
        self.cells = len(bitmap)
        padded = (
            np.pad(bitmap.astype(np.float32), 1, constant_values=1.0)
            if margin
            else np.pad(bitmap.astype(np.float32), 1, mode="edge")
        )
        p00, p01, p10, p11 = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
        # value = c0 + c1 x + c2 y + c3 x y with x, y = 0..1 across the ramps around a grid point.
        self._coefficients = tuple(
            np.ascontiguousarray(c).ravel() for c in (p00, p01 - p00, p10 - p00, p11 - p10 - p01 + p00)
        )

    @cached_property
    def crossings(self) -> Array:
        """Cell coordinates (N, 2) of the points where cell borders cross, row by row."""
        steps = np.arange(self.cells + 1, dtype=np.float64)
        a, b = np.meshgrid(steps, steps)
        return np.column_stack([a.ravel(), b.ravel()])

    def sample(self, a: Values, b: Values, slopes: Array) -> Values:
        """Brightness 0..1 at cell coordinates ``a`` (rightwards), ``b`` (downwards), 0..n over the black square.

        ``slopes`` (N, 2, 2): by how many cells a and b change from a pixel to the next one right, down, at each of
        the ``crossings``. Where a cell is smaller than a pixel the pattern is only interpolated.
        """
        column = np.clip(np.rint(a), 0, self.cells)
        row = np.clip(np.rint(b), 0, self.cells)
        index = (row * (self.cells + 1) + column).astype(np.intp)
        x = _ramp(a - column, slopes[:, 0], index)
        y = _ramp(b - row, slopes[:, 1], index)
        c0, c1, c2, c3 = (np.take(c, index) for c in self._coefficients)
        value: Values = c0 + c1 * x + (c2 + c3 * x) * y
        return value


def _ramp(from_border: Values, slopes: Array, index: NDArray[np.intp]) -> Values:
    """How far beyond the nearest cell border each pixel is, 0..1; ``slopes`` (N, 2) of this coordinate."""
    steep = np.maximum(np.hypot(slopes[:, 0], slopes[:, 1]), 1e-6)[:, None]
    normals = np.abs(slopes) / steep
    pixels_per_cell = np.maximum(1.0 / steep[:, 0], normals.sum(axis=1))
    scale, across, down = (np.take(v.astype(np.float32), index) for v in (pixels_per_cell, *normals.T))
    return inner_share(from_border * scale, across, down)


def _halvings(ratio: float, texels: int) -> int:
    """How often to halve so that a texel is between 0.71 and 1.41 pixels, never above the footprint by more."""
    if not np.isfinite(ratio) or ratio <= 1.0:
        return 0
    return min(round(float(np.log2(ratio))), max(texels.bit_length() - 1, 0))
