from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.scene import burn_number, read_number


@given(st.integers(0, 2**32 - 1))
def test_a_burnt_number_is_read_back(number: int) -> None:
    picture = np.full((60, 300, 3), 77, np.uint8)
    burn_number(picture, number)
    assert read_number(picture) == number


@pytest.mark.parametrize("quality", [95, 60])
def test_it_survives_noise_blur_and_jpeg(quality: int) -> None:
    random = np.random.default_rng(0)
    picture = random.integers(0, 255, (120, 400, 3)).astype(np.uint8)
    burn_number(picture, 123456789)
    noisy = np.clip(cv2.GaussianBlur(picture, (5, 5), 0.8) + random.normal(0, 5, picture.shape), 0, 255)
    _, packed = cv2.imencode(".jpg", noisy.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert read_number(cv2.imdecode(packed, cv2.IMREAD_COLOR)) == 123456789


def test_there_is_no_number_where_none_was_burnt() -> None:
    assert read_number(np.full((60, 300, 3), 128, np.uint8)) is None
    assert read_number(np.zeros((10, 10, 3), np.uint8)) is None
