"""Sharpness by the markers' edges: independent of contrast, sensitive to blur of any direction."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.labels import Quad
from common.quality import edge_sharpness, sharpness_of

ANGLE_DEG = 17.0


def marker(angle_deg: float = ANGLE_DEG) -> tuple[NDArray[np.uint8], Quad]:
    """A dark square of 100 px, turned, drawn fourfold and reduced, so that its edges lie between pixels."""
    big = np.full((800, 800), 200, np.uint8)
    big[200:600, 200:600] = 40
    turn = cv2.getRotationMatrix2D((399.5, 399.5), angle_deg, 1)
    turned = cv2.warpAffine(big, turn, (800, 800), borderValue=(200,), flags=cv2.INTER_CUBIC)
    corners = np.array([[199.5, 199.5, 1], [599.5, 199.5, 1], [599.5, 599.5, 1], [199.5, 599.5, 1]]) @ turn.T
    picture = np.asarray(cv2.resize(turned, (200, 200), interpolation=cv2.INTER_AREA), np.uint8)
    quad = tuple((float(x), float(y)) for x, y in (corners + 0.5) / 4 - 0.5)
    return picture, quad  # type: ignore[return-value]


def blurred(picture: NDArray[np.uint8], sigma: float) -> NDArray[np.uint8]:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), np.uint8)


def test_the_more_blur_the_less() -> None:
    picture, quad = marker()
    found = [edge_sharpness(picture, quad), *(edge_sharpness(blurred(picture, sigma), quad) for sigma in (1, 2, 3, 5))]
    values = [value for value in found if value is not None]
    assert len(values) == 5
    assert values == sorted(values, reverse=True)
    assert values[0] > 60
    # A Gaussian's steepest slope is 1 / (sigma sqrt(2 pi)) of the contrast.
    assert values[2] == pytest.approx(100 / (2 * np.sqrt(2 * np.pi)), abs=2)


@pytest.mark.parametrize("size", [(9, 1), (1, 9)])
def test_motion_in_one_direction_is_found(size: tuple[int, int]) -> None:
    picture, quad = marker()
    value = edge_sharpness(np.asarray(cv2.blur(picture, size), np.uint8), quad)
    assert value is not None
    assert value == pytest.approx(100 / 9, abs=3)


def test_contrast_doesn_t_matter_and_colour_neither() -> None:
    picture, quad = marker()
    pale = (picture // 4 + 100).astype(np.uint8)
    sharp, of_pale = edge_sharpness(picture, quad), edge_sharpness(pale, quad)
    assert sharp is not None
    assert of_pale == pytest.approx(sharp, rel=0.1)
    assert edge_sharpness(np.dstack([picture] * 3), quad) == pytest.approx(sharp, abs=1)


def test_without_an_edge_to_judge_there_is_no_number() -> None:
    picture, quad = marker()
    assert edge_sharpness(np.full_like(picture, 128), quad) is None
    far: Quad = ((900.0, 900.0), (950.0, 900.0), (950.0, 950.0), (900.0, 950.0))
    assert edge_sharpness(picture, far) is None
    assert sharpness_of(picture, []) is None
    assert sharpness_of(picture, [far, quad]) == edge_sharpness(picture, quad)
