"""Depth that is missing where markers are: black ink eats infrared, so a marker may be a hole in the depth picture."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.uint8]

_RIM = 1.8
"""The surroundings that are compared: out to a square this much larger than the marker."""
_LACKS = 0.2
"""A marker is a hole if this share more of its pixels lacks depth than around it: edges and noise cost less."""


def depth_at_markers(depth: NDArray[np.uint16], corners: Iterable[NDArray[np.float64]]) -> tuple[float, float] | None:
    """The shares (0..1) of valid depth pixels on the markers and around them; None without a marker in the picture.

    ``depth`` (H, W), 0 = invalid; ``corners`` (4, 2) px of each marker in that picture.
    """
    on, around = np.zeros(depth.shape, np.uint8), np.zeros(depth.shape, np.uint8)
    for outline in corners:
        centre = outline.mean(axis=0)
        _fill(around, centre + _RIM * (outline - centre))
        _fill(on, outline)
    around[on > 0] = 0
    if not on.any() or not around.any():
        return None
    valid = depth > 0
    return float(valid[on > 0].mean()), float(valid[around > 0].mean())


def punched(on: float, around: float) -> bool:
    """Whether these shares mean that the markers themselves cost depth."""
    return around - on > _LACKS


def _fill(mask: Mask, outline: NDArray[np.float64]) -> None:
    cv2.fillConvexPoly(mask, np.rint(outline).astype(np.int32), 255)
