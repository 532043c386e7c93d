"""Frames that are the one before once more."""

from __future__ import annotations

import numpy as np

from services.capture.cameras.base import Grabbed
from services.capture.repeats import Repeats


def noisy(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (90, 120, 3), np.uint8)


def test_a_device_time_decides_where_there_is_one() -> None:
    repeats = Repeats()
    frames = [Grabbed(noisy(1), device_ns=at) for at in (0, 10, 10, 20)]
    assert [repeats.repeated(frame) for frame in frames] == [False, False, True, False]
    assert [repeats.still_ns(frame, at) for at, frame in enumerate(frames)] == [0, 0, 0, 0]


def test_without_one_the_picture_does_bit_by_bit() -> None:
    repeats = Repeats()
    still = noisy(1)
    nearly = still.copy()
    nearly[1, 1, 1] ^= 1  # between the pixels that are looked at first
    pictures = (still, still, still, still, nearly, nearly, noisy(2))
    assert not any(repeats.repeated(Grabbed(picture)) for picture in pictures)
    for_ns = [repeats.still_ns(Grabbed(picture.copy()), 10 * number) for number, picture in enumerate(pictures)]
    assert for_ns == [0, 0, 10, 20, 0, 10, 0], "it takes one to be sure of the first"
