"""Blur and near-duplicates."""

from __future__ import annotations

import cv2
import numpy as np

from common.geometry import Pose
from common.quality import ALIKE_BITS, blur, differing_bits, near_views, perceptual_hash

TEXTURE = cv2.resize(np.random.default_rng(1).integers(0, 256, (30, 40, 3), dtype=np.uint8), (320, 240))


def test_blur_rises_with_blur_in_one_direction_too() -> None:
    grey = cv2.cvtColor(TEXTURE, cv2.COLOR_BGR2GRAY)
    grey = np.where(grey > 127, 255, 0).astype(np.uint8)
    levels = [blur(np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma))) for sigma in (0.5, 1.5, 4.0, 9.0)]
    assert levels == sorted(levels)
    assert levels[-1] - levels[0] > 0.3
    assert blur(np.asarray(cv2.blur(grey, (21, 1)))) > blur(grey) + 0.2
    assert blur(np.full((40, 40), 7, np.uint8)) == 1.0


def test_a_hash_survives_noise_size_and_compression_and_not_another_picture() -> None:
    known = perceptual_hash(TEXTURE)
    noisy = np.clip(TEXTURE + np.random.default_rng(2).normal(0, 8, TEXTURE.shape), 0, 255).astype(np.uint8)
    small = np.asarray(cv2.resize(TEXTURE, (160, 120), interpolation=cv2.INTER_AREA))
    jpeg = cv2.imdecode(cv2.imencode(".jpg", TEXTURE, [cv2.IMWRITE_JPEG_QUALITY, 50])[1], cv2.IMREAD_COLOR)
    same = np.array([perceptual_hash(np.asarray(one)) for one in (noisy, small, jpeg)], dtype=np.uint64)
    assert (differing_bits(known, same) <= ALIKE_BITS).all()
    other = np.array([perceptual_hash(np.ascontiguousarray(TEXTURE[::-1]))], dtype=np.uint64)
    assert differing_bits(known, other)[0] > ALIKE_BITS


def test_views_are_near_by_turn_and_place_of_every_object() -> None:
    def view(turn: float = 0.0, x: float = 0.0) -> dict[str, Pose]:
        return {
            "a": Pose.from_rvec([0, np.radians(turn), 0], [x, 0, 1000]),
            "b": Pose.from_rvec([0, 0, 0], [0, 0, 2000]),
        }

    others = [view(), view(turn=5), view(turn=7), view(x=30), view(x=50), {"a": view()["a"]}, {}]
    assert near_views([view()], others).tolist() == [[True, True, False, True, False, False, False]]
    assert near_views([{}], others).tolist() == [[False] * 6 + [True]]
