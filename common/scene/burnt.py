"""A frame number burnt into the picture: digits for people, a strip of 32 squares for programs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_SQUARE = 8
_BITS = 32
_TOP, _LEFT = 8, 8
_TEXT_HEIGHT = 26


def burn_number(bgr: NDArray[np.uint8], number: int) -> None:
    """Write ``number`` (0 ... 2^32 - 1) into the top left corner of a picture (H, W, 3), in place.

    The picture must be at least 272 px wide and 42 px high; smaller ones are cut off.
    """
    cv2.rectangle(
        bgr, (0, 0), (_LEFT * 2 + _BITS * _SQUARE, _TOP + _SQUARE + _TEXT_HEIGHT), (128, 128, 128), cv2.FILLED
    )
    for bit in range(_BITS):
        level = 255 if number >> (_BITS - 1 - bit) & 1 else 0
        x = _LEFT + bit * _SQUARE
        cv2.rectangle(bgr, (x, _TOP), (x + _SQUARE - 1, _TOP + _SQUARE - 1), (level, level, level), cv2.FILLED)
    place = (_LEFT, _TOP + _SQUARE + _TEXT_HEIGHT - 8)
    cv2.putText(bgr, f"{number:010d}", place, cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 1, cv2.LINE_8)


def read_number(bgr: NDArray[np.uint8]) -> int | None:
    """The number that ``burn_number`` wrote into a picture, None where there is no readable strip."""
    if bgr.shape[1] < _LEFT + _BITS * _SQUARE or bgr.shape[0] < _TOP + _SQUARE:
        return None
    strip = bgr[_TOP : _TOP + _SQUARE, _LEFT : _LEFT + _BITS * _SQUARE].mean(axis=2)
    levels = strip.reshape(_SQUARE, _BITS, _SQUARE)[2:-2, :, 2:-2].mean(axis=(0, 2))
    if np.any((levels > 64) & (levels < 192)):
        return None
    return int("".join("1" if level > 128 else "0" for level in levels), 2)
