"""Depth for the eye: viridis over a range that follows the scene slowly; no depth is hatched."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_STEP = 8
"""Every so many pixels are enough to find the range."""
_FOLLOW = 0.2
"""How far the range moves towards what is seen, a picture: it must not flicker."""
_HATCH = 6
_DARK, _LIGHT = 16, 64


class DepthColours:
    """Colours depth pictures of one camera; ``range_mm`` is what the colours stand for."""

    def __init__(self) -> None:
        self.range_mm: tuple[float, float] = (0.0, 0.0)

    def paint(self, depth: NDArray[np.uint16], unit_mm: float) -> NDArray[np.uint8]:
        """A depth picture (H, W) uint16, 0 = invalid, as BGR (H, W, 3)."""
        self._follow(depth, unit_mm)
        low, high = self.range_mm
        scale = 255.0 / max(high - low, 1.0)
        grey = np.clip((depth.astype(np.float32) * unit_mm - low) * scale, 0, 255).astype(np.uint8)
        painted = np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), dtype=np.uint8)
        invalid = depth == 0
        if invalid.any():
            painted[invalid] = _hatched(*depth.shape)[invalid]
        return painted

    def _follow(self, depth: NDArray[np.uint16], unit_mm: float) -> None:
        seen = depth[::_STEP, ::_STEP]
        seen = seen[seen > 0]
        if seen.size == 0:
            return
        low, high = (float(value) * unit_mm for value in np.percentile(seen, (2, 98)))
        high = max(high, low + 100.0)
        before_low, before_high = self.range_mm
        if before_high <= before_low:
            self.range_mm = (low, high)
        else:
            self.range_mm = (before_low + _FOLLOW * (low - before_low), before_high + _FOLLOW * (high - before_high))


def _hatched(height: int, width: int) -> NDArray[np.uint8]:
    rows, columns = np.ogrid[:height, :width]
    line = ((rows + columns) % _HATCH == 0)[..., np.newaxis]
    return np.where(line, np.uint8(_LIGHT), np.uint8(_DARK)).repeat(3, axis=2).astype(np.uint8)
