"""How blurred a picture is, without another one to compare it with."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_LENGTH = 9


def blur(grey: NDArray[np.uint8]) -> float:
    """0 (sharp) to 1 (nothing but blur) of a picture (H, W) uint8; 1 for one without any structure.

    A picture that is sharp loses much of its neighbouring pixels' differences when it is smoothed, a blurred one
    little. The worse of both directions, so that motion blur counts. Method: Crete, Dolmiere, Ladret and Nicolas,
    "The blur effect: perception and estimation with a new no-reference perceptual blur metric", SPIE 2007, eq. 1-6.
    """
    picture = grey.astype(np.float32)
    return max(_along(picture, axis) for axis in (0, 1))


def _along(picture: NDArray[np.float32], axis: int) -> float:
    size = (1, _LENGTH) if axis == 0 else (_LENGTH, 1)
    smoothed = cv2.blur(picture, size)
    before = np.abs(np.diff(picture, axis=axis))
    lost = np.maximum(0.0, before - np.abs(np.diff(smoothed, axis=axis)))
    total = float(before.sum())
    return 1.0 if total == 0.0 else (total - float(lost.sum())) / total
