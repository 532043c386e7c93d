"""The fine structure of a surface, noise included, taken from real pixels nearby. Pure."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_BLOCK = 16
_BOX = 9
"""What is finer than two boxes of so many px (together a Gaussian with a sigma of 3.7 px) is grain."""
_CALM = 1.6
"""Blocks whose variance is above so many times the lower quartile hold a feature, not grain."""
_RAMP = np.sin((np.arange(_BLOCK) + 0.5) * np.pi / _BLOCK)
_WINDOW = np.repeat(np.outer(_RAMP, _RAMP), 3, axis=1).astype(np.float32)
"""(rows, columns x channels)"""


def grain(bgr: Picture, sources: Mask, size: tuple[int, int], seed: int) -> Floats | None:
    """Grain (height, width, 3) float32 of a size (width, height) for a crop (H, W, 3); None if none can be learnt.

    Blocks of the sources' residuals are laid half over each other, weighted so that their variance stays what it
    is in the sources (windows whose squares add up to one).
    """
    donors = _donors(bgr, sources)
    if donors is None:
        return None
    residual, places = donors
    random = np.random.default_rng(seed)
    half = _BLOCK // 2
    width, height = size
    # Rows of pixels with their channels side by side: a block's row is one run of memory.
    canvas = np.zeros((height + half + _BLOCK, (width + half + _BLOCK) * 3), dtype=np.float32)
    blocks = np.lib.stride_tricks.sliding_window_view(residual.reshape(len(residual), -1), _WINDOW.shape)[:, ::3]
    for y in (0, half):
        for x in (0, half * 3):
            # A quarter of the blocks, which lie side by side: one copy for all of them.
            rows, columns = -((y - half - height) // _BLOCK), -((x - (half + width) * 3) // _WINDOW.shape[1])
            chosen = places[random.integers(0, len(places), rows * columns)]
            tiles = blocks[chosen[:, 0], chosen[:, 1]]
            tiles *= _WINDOW
            part = canvas[y : y + rows * _BLOCK, x : x + columns * _WINDOW.shape[1]]
            places_of_tiles = part.reshape(rows, _BLOCK, columns, -1)  # a view
            places_of_tiles += tiles.reshape(rows, columns, *_WINDOW.shape).swapaxes(1, 2)
    return canvas.reshape(len(canvas), -1, 3)[half : half + height, half : half + width]


def _donors(bgr: Picture, sources: Mask) -> tuple[Floats, NDArray[np.intp]] | None:
    """The residuals (H, W, 3), and the upper left corners (N, 2) of calm blocks of sources."""
    mask = sources.view(np.uint8)
    whole = cv2.erode(mask, np.ones((_BLOCK, _BLOCK), np.uint8), anchor=(0, 0), borderValue=0)[::2, ::2] > 0
    if not whole.any():
        return None
    values = np.asarray(cv2.bitwise_and(bgr, bgr, mask=mask), dtype=np.uint8)
    share = cv2.merge([np.maximum(_smoothed(mask), np.float32(1e-3))] * 3)
    residual = cv2.subtract(values, cv2.divide(_smoothed(values), share), dtype=cv2.CV_32F)
    # Green is enough to tell where a feature lies.
    green = cv2.extractChannel(residual, 1)
    energy = cv2.boxFilter(green * green, -1, (_BLOCK, _BLOCK), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)[::2, ::2]
    among = np.sort(energy[whole])
    calm = whole & (energy <= _CALM * float(among[len(among) // 4]) + 1e-3)
    return np.asarray(residual, dtype=np.float32), np.argwhere(calm) * 2


def _smoothed(values: Picture) -> Floats:
    """Nearly a Gaussian: two boxes, which cost the same for any width."""
    size = (_BOX, _BOX)
    return np.asarray(cv2.blur(cv2.boxFilter(values, cv2.CV_32F, size), size), dtype=np.float32)
