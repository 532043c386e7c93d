"""Outlines as pixels."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rasterised(loops: Iterable[Array], size_mm: tuple[float, float], px_per_mm: float) -> NDArray[np.uint8]:
    """A picture (H, W), 255 with the loops filled 0 by the even-odd rule, of an area from (0, 0) to ``size_mm``.

    For loops (n, 2), mm, whose edges are level or upright; an edge lies on the pixel border nearest to it.
    """
    width, height = (max(1, round(value * px_per_mm)) for value in size_mm)
    # An upright edge turns black to white, or back, for all that is right of it.
    turns = np.zeros((height, width + 1), dtype=bool)
    for loop in loops:
        points = np.rint(loop * px_per_mm).astype(int)
        for (x, y0), (_, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
            turns[min(y0, y1) : max(y0, y1), x] ^= True
    black = np.logical_xor.accumulate(turns, axis=1)[:, :width]
    return np.where(black, 0, 255).astype(np.uint8)
