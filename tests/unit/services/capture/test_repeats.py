"""Frames that are the one before once more."""

from __future__ import annotations

import numpy as np

from services.capture.cameras.base import Grabbed
from services.capture.repeats import Repeats


def noisy(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (90, 120, 3), np.uint8)


def test_a_device_time_decides_where_there_is_one() -> None:
    repeats = Repeats()
    same = noisy(1)
    judged = [repeats.repeated(Grabbed(same, device_ns=at), by_picture=True) for at in (0, 10, 10, 20)]
    assert judged == [False, False, True, False]


def test_without_one_the_picture_does_bit_by_bit() -> None:
    repeats = Repeats()
    still = noisy(1)
    nearly = still.copy()
    nearly[1, 1, 1] ^= 1  # between the pixels that are looked at first
    pictures = (still, still, still, still, nearly, nearly, noisy(2))
    judged = [repeats.repeated(Grabbed(picture.copy()), by_picture=True) for picture in pictures]
    assert judged == [False, False, True, True, False, True, False], "it takes one to be sure of the first"


def test_recorded_pictures_may_stay_the_same() -> None:
    repeats = Repeats()
    assert not any(repeats.repeated(Grabbed(noisy(1)), by_picture=False) for _ in range(5))
