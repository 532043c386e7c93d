"""What gives a camera away that runs but gives nothing new: the same frame again and again."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from services.capture.cameras.base import Grabbed

_STEP = 16


class Repeats:
    """Whether a frame is the one before once more.

    By its device time if it has one; else by its picture, which no live camera gives twice, bit by bit (its noise
    alone changes it). Looks at a few pixels, and at all of them only where these are the same.
    """

    def __init__(self) -> None:
        self._device_ns: int | None = None
        self._sample: NDArray[np.uint8] | None = None
        self._checksum: int | None = None

    def repeated(self, grabbed: Grabbed, *, by_picture: bool) -> bool:
        """Judge the next frame; with ``by_picture`` also one without a device time."""
        if grabbed.device_ns is not None:
            same = grabbed.device_ns == self._device_ns
            self._device_ns = grabbed.device_ns
            return same
        return by_picture and self._same_picture(grabbed.bgr)

    def _same_picture(self, bgr: NDArray[np.uint8]) -> bool:
        sample = bgr[::_STEP, ::_STEP].copy()
        known, self._sample = self._sample, sample
        if known is None or known.shape != sample.shape or not np.array_equal(known, sample):
            self._checksum = None
            return False
        before, self._checksum = self._checksum, zlib.crc32(bgr.data)
        return before == self._checksum
