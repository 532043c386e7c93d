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
_WINDOW = np.outer(_RAMP, _RAMP).astype(np.float32)[..., None]


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
    down, along = height // half + 2, width // half + 2
    canvas = np.zeros(((down + 2) // 2 * _BLOCK + half, (along + 2) // 2 * _BLOCK + half, 3), dtype=np.float32)
    blocks = np.lib.stride_tricks.sliding_window_view(residual, (_BLOCK, _BLOCK), axis=(0, 1))
    for y in (0, half):
        for x in (0, half):
            # A quarter of the blocks, which lie side by side: one copy for all of them.
            rows, columns = (canvas.shape[0] - y) // _BLOCK, (canvas.shape[1] - x) // _BLOCK
            chosen = places[random.integers(0, len(places), rows * columns)]
            tiles = blocks[chosen[:, 0], chosen[:, 1]].transpose(0, 2, 3, 1) * _WINDOW
            laid = tiles.reshape(rows, columns, _BLOCK, _BLOCK, 3).swapaxes(1, 2)
            part = canvas[y : y + rows * _BLOCK, x : x + columns * _BLOCK]
            part += laid.reshape(part.shape)
    return canvas[half : half + height, half : half + width]


def _donors(bgr: Picture, sources: Mask) -> tuple[Floats, NDArray[np.intp]] | None:
    """The residuals (H, W, 3), and the upper left corners (N, 2) of calm blocks of sources."""
    mask = sources.view(np.uint8)
    whole = cv2.erode(mask, np.ones((_BLOCK, _BLOCK), np.uint8), anchor=(0, 0), borderValue=0)[::2, ::2] > 0
    if not whole.any():
        return None
    values = cv2.bitwise_and(bgr, bgr, mask=mask).astype(np.float32)
    weights = np.asarray(_smoothed(mask.astype(np.float32)), dtype=np.float32)
    residual = values - _smoothed(values) / np.maximum(weights, 1e-3)[..., None]
    # Green is enough to tell where a feature lies.
    green = np.ascontiguousarray(residual[..., 1])
    energy = cv2.boxFilter(green * green, -1, (_BLOCK, _BLOCK), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)[::2, ::2]
    calm = whole & (energy <= _CALM * float(np.quantile(energy[whole], 0.25)) + 1e-3)
    return np.asarray(residual, dtype=np.float32), np.argwhere(calm) * 2


def _smoothed(values: Floats) -> Floats:
    """Nearly a Gaussian: two boxes, which cost the same for any width."""
    size = (_BOX, _BOX)
    return np.asarray(cv2.blur(cv2.blur(values, size), size), dtype=np.float32)
