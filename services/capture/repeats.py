"""What gives a camera away that runs but gives nothing new: the same frame again and again."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from services.capture.cameras.base import Grabbed

_STEP = 16


class Repeats:
    """Judges the frames of one stream in their order.

    A frame with the device time of the one before is that one once more. Without device times the picture has to do:
    no live camera gives one twice, bit by bit, as its noise alone changes it; yet twice is no proof, only for long is.
    """

    def __init__(self) -> None:
        self._device_ns: int | None = None
        self._sample: NDArray[np.uint8] | None = None
        self._checksum: int | None = None
        self._since_ns = 0

    def repeated(self, grabbed: Grabbed) -> bool:
        """Whether this frame is the one before, by its device time."""
        same = grabbed.device_ns is not None and grabbed.device_ns == self._device_ns
        self._device_ns = grabbed.device_ns
        return same

    def still_ns(self, grabbed: Grabbed, now_ns: int) -> int:
        """For how long the picture has not changed by a bit; 0 for a frame that has a device time.

        Looks at a few pixels, and at all of them only where these are the same.
        """
        if grabbed.device_ns is not None:
            return 0
        sample = grabbed.bgr[::_STEP, ::_STEP].copy()
        known, self._sample = self._sample, sample
        before, self._checksum = self._checksum, None
        if known is not None and np.array_equal(known, sample):
            self._checksum = zlib.crc32(grabbed.bgr.data)
            if self._checksum == before:
                return now_ns - self._since_ns
        self._since_ns = now_ns
        return 0
