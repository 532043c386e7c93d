"""Sensor noise from a bank: made once, laid over each frame at an offset that follows from seed and index."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.seeds import generator

Pixels = TypeVar("Pixels", NDArray[np.uint8], NDArray[np.uint16])
_SPARE = 128
"""The bank is larger than the picture by this, hence 128 x 128 different offsets."""
_PER_FRAME = 1000
"""Cameras may be faster than the scene's 30 frames to the second: then indices are fractions."""


class NoiseBank:
    """Gaussian noise of one ``sigma`` for pictures of one shape and type.

    Kept as what to add and what to take away, each unsigned, so that two saturating passes do it.
    """

    def __init__(
        self, seed: int, shape: tuple[int, ...], sigma: float, dtype: type[np.uint8] | type[np.uint16]
    ) -> None:
        self._seed = seed
        self._shape = shape
        size = (shape[0] + _SPARE, shape[1] + _SPARE, *shape[2:])
        drawn = generator(seed, "noise", len(shape)).standard_normal(size, dtype=np.float32)
        drawn = np.rint(drawn * np.float32(sigma)).astype(np.int32)
        limit = int(np.iinfo(dtype).max)
        self._more = np.clip(drawn, 0, limit).astype(dtype)
        self._less = np.clip(-drawn, 0, limit).astype(dtype)

    def apply(self, pixels: Pixels, index: float) -> None:
        """Add the noise of frame ``index`` to a picture in place; a thousandth of a frame later it is another."""
        random = generator(self._seed, "offset", round(index * _PER_FRAME))
        down, right = (int(v) for v in random.integers(0, _SPARE, 2))
        window = (slice(down, down + self._shape[0]), slice(right, right + self._shape[1]))
        cv2.add(pixels, self._more[window], dst=pixels)
        cv2.subtract(pixels, self._less[window], dst=pixels)
