"""The Kinect v2's arrays made into pictures: mirrored back, trimmed, scaled with the intrinsics, timed."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from services.capture.cameras.kinect2_frames import (
    TickClock,
    camera_model,
    colour_picture,
    depth_picture,
    lateness_ms,
)
from tests.support.rendered_marker import drawing

FULL = (1920, 1080)
SIZES = [FULL, (1280, 720), (960, 540), (640, 360)]
COLOUR = SimpleNamespace(fx=1081.4, fy=1080.2, cx=962.3, cy=541.7)


def big(depth: np.ndarray) -> np.ndarray:
    """As Registration fills it: blank rows above and below."""
    made = np.full((1082, 1920), np.inf, np.float32)
    made[1:-1] = depth
    return made


def test_a_marker_can_be_read_again_only_once_it_is_turned_back() -> None:
    right_way = np.full((1080, 1920, 3), 200, np.uint8)
    marker = cv2.resize(drawing("DICT_APRILTAG_36h11", 7) * 255, None, fx=40, fy=40, interpolation=cv2.INTER_NEAREST)
    right_way[300 : 300 + len(marker), 500 : 500 + len(marker)] = marker[..., None]
    given = cv2.cvtColor(cv2.flip(right_way, 1), cv2.COLOR_BGR2BGRA)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    assert detector.detectMarkers(given[..., :3])[1] is None
    picture = colour_picture(given, *FULL)
    assert np.array_equal(picture, right_way)
    for size in SIZES:
        ids = detector.detectMarkers(colour_picture(given, *size))[1]
        assert ids is not None
        assert ids.ravel().tolist() == [7]


@pytest.mark.parametrize("size", SIZES)
def test_the_intrinsics_are_those_of_the_turned_and_scaled_picture(size: tuple[int, int]) -> None:
    """A patch around where a point is seen: its centre of mass in the picture is where the model projects it."""
    point = np.array([230.0, -140.0, 1100.0])
    # In the mirrored picture right is left.
    u, v = -point[0] / point[2] * COLOUR.fx + COLOUR.cx, point[1] / point[2] * COLOUR.fy + COLOUR.cy
    y, x = np.mgrid[:1080, :1920]
    bump = 255 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 12.0**2))
    given = np.repeat(bump[..., None], 4, axis=2).round().astype(np.uint8)
    picture = colour_picture(given, *size)[..., 0].astype(float)
    assert picture.shape == size[::-1]
    moments = cv2.moments(picture)
    seen = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    projected, _ = camera_model(COLOUR, *size).project([point])
    assert np.abs(seen - projected[0]).max() < 0.02


def test_depth_is_trimmed_turned_rounded_and_invalid_is_nought() -> None:
    depth = np.full((1080, 1920), 1000.4, np.float32)
    depth[0, 0], depth[0, 1], depth[0, 2] = np.inf, np.nan, -5.0
    depth[1079, 1919], depth[5, 7], depth[6, 7] = 4499.6, 65536.0, 0.2
    made = depth_picture(big(depth), *FULL)
    assert (made.dtype, made.shape) == (np.uint16, (1080, 1920))
    assert made.flags.c_contiguous
    assert made[0, -3:].tolist() == [0, 0, 0]
    assert made[1079, 0] == 4500
    assert made[5, -8] == 0
    assert made[6, -8] == 0
    assert made[10, 10] == 1000
    assert np.count_nonzero(made == 0) == 5


@pytest.mark.parametrize("size", SIZES[1:])
def test_smaller_depth_keeps_to_real_values_and_to_colour(size: tuple[int, int]) -> None:
    near, far = 800.0, 3000.0
    depth = np.full((1080, 1920), far, np.float32)
    depth[400:700, 1200:1500] = near
    made = depth_picture(big(depth), *size)
    assert sorted(np.unique(made)) == [near, far]
    grey = np.where(depth == near, 255, 0).astype(np.uint8)
    picture = colour_picture(np.repeat(grey[..., None], 4, axis=2), *size)[..., 0]
    apart = (made == near) != (picture > 127)
    assert apart.mean() < 0.002, "at most a line of pixels at the edge"


def test_the_difference_of_the_times_survives_the_clocks_wrap() -> None:
    assert lateness_ms(1000, 200) == 100.0
    assert lateness_ms(200, 1000) == -100.0
    assert lateness_ms(100, 2**32 - 700) == 100.0


def test_the_clock_goes_on_where_its_32_bits_begin_anew() -> None:
    clock = TickClock()
    first, second = clock.ns(2**32 - 8), clock.ns(8)
    assert first > 0
    assert second - first == 16 * 125_000
    assert clock.ns(0) == second - 8 * 125_000, "a frame that comes out of order keeps its time"
