"""The fine structure of a surface, noise included, taken from real pixels nearby. Pure."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_BLOCK = 16
_OVERLAP = 4
"""Blocks share so many pixels with each neighbour: more than grain is wide, and the fewer the less there is to lay."""
_STEP = _BLOCK - _OVERLAP
_BOX = 9
"""What is finer than two boxes of so many px (together a Gaussian with a sigma of 3.7 px) is grain."""
_CALM = 1.6
"""Blocks whose variance is above so many times the lower quartile hold a feature, not grain."""
_RAMP = np.sin((np.arange(_OVERLAP) + 0.5) * np.pi / (2 * _OVERLAP))
_PROFILE = np.concatenate([_RAMP, np.ones(_BLOCK - 2 * _OVERLAP), _RAMP[::-1]])
_WINDOW = np.repeat(np.outer(_PROFILE, _PROFILE), 3, axis=1).astype(np.float32)
"""(rows, columns x channels)"""


def grain(bgr: Picture, sources: Mask, size: tuple[int, int], seed: int) -> Floats | None:
    """Grain (height, width, 3) float32 of a size (width, height) for a crop (H, W, 3); None if none can be learnt.

    Blocks of the sources' residuals are laid side by side, their edges over each other and weighted so that their
    variance stays what it is in the sources (windows whose squares add up to one).
    """
    donors = _donors(bgr, sources)
    if donors is None:
        return None
    residual, places = donors
    random = np.random.default_rng(seed)
    width, height = size
    down, right = -(-(height + _OVERLAP) // _STEP), -(-(width + _OVERLAP) // _STEP)
    # Rows of pixels with their channels side by side: a block's row is one run of memory.
    canvas = np.zeros(((down + 2) * _STEP, (right + 2) * _STEP * 3), dtype=np.float32)
    blocks = np.lib.stride_tricks.sliding_window_view(residual.reshape(len(residual), -1), _WINDOW.shape)[:, ::3]
    for y in (0, 1):
        for x in (0, 1):
            # A quarter of the blocks, which don't touch each other: one copy for all of them.
            rows, columns = (down - y + 1) // 2, (right - x + 1) // 2
            chosen = places[random.integers(0, len(places), rows * columns)]
            tiles = blocks[chosen[:, 0], chosen[:, 1]]
            tiles *= _WINDOW
            part = canvas[y * _STEP :, x * _STEP * 3 :][: rows * 2 * _STEP, : columns * 2 * _STEP * 3]
            apart = part.reshape(rows, 2 * _STEP, columns, 6 * _STEP)[:, :_BLOCK, :, : _WINDOW.shape[1]]  # a view
            apart += tiles.reshape(rows, columns, *_WINDOW.shape).swapaxes(1, 2)
    return canvas.reshape(len(canvas), -1, 3)[_OVERLAP : _OVERLAP + height, _OVERLAP : _OVERLAP + width]


def _donors(bgr: Picture, sources: Mask) -> tuple[Floats, NDArray[np.intp]] | None:
    """The residuals (H, W, 3), and the upper left corners (N, 2) of calm blocks of sources."""
    mask = sources.view(np.uint8)
    whole = cv2.erode(mask, np.ones((_BLOCK, _BLOCK), np.uint8), anchor=(0, 0), borderValue=0)[::2, ::2] > 0
    if not whole.any():
        return None
    values = np.asarray(cv2.bitwise_and(bgr, bgr, mask=mask), dtype=np.uint8)
    share = _smoothed(mask)
    share = np.asarray(cv2.cvtColor(np.maximum(share, np.float32(1e-3), out=share), cv2.COLOR_GRAY2BGR))
    # In place, for what doesn't fit into the processor's cache costs more than what is done with it.
    residual = _smoothed(values)
    cv2.divide(residual, share, dst=residual)
    cv2.subtract(values, residual, dst=residual, dtype=cv2.CV_32F)
    # Green is enough to tell where a feature lies.
    green = cv2.extractChannel(residual, 1)
    cv2.multiply(green, green, dst=green)
    energy = cv2.boxFilter(green, -1, (_BLOCK, _BLOCK), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)[::2, ::2]
    among = energy[whole]
    quartile = float(np.partition(among, len(among) // 4)[len(among) // 4])
    rows, columns = np.nonzero(whole & (energy <= _CALM * quartile + 1e-3))
    return residual, np.column_stack([rows, columns]) * 2


def _smoothed(values: Picture) -> Floats:
    """Nearly a Gaussian: two boxes, which cost the same for any width."""
    size = (_BOX, _BOX)
    once = cv2.boxFilter(values, cv2.CV_32F, size)
    return np.asarray(cv2.blur(once, size, dst=once), dtype=np.float32)
