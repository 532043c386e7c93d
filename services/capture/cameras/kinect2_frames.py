"""What the Kinect v2's library gives, made into tagmill's pictures: pure functions on its arrays.

libfreenect2 gives all its pictures mirrored left to right, as the maker's own SDK does (OpenKinect/libfreenect2 issue
172). A mirrored marker is no marker, and a mirrored pose is none, so colour, depth and intrinsics are turned back here.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel

WIDTH, HEIGHT = 1920, 1080
"""Of the colour picture."""
TICK_NS = 125_000
"""The camera's clock counts steps of 0.125 ms, in 32 bits."""
_TICKS = 1 << 32


def colour_picture(bgrx: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """(1080, 1920, 4) uint8 BGRX, mirrored, as (``height``, ``width``, 3) BGR the right way round; a copy."""
    if (width, height) != (WIDTH, HEIGHT):
        bgrx = np.asarray(cv2.resize(bgrx, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    bgr = cv2.cvtColor(bgrx, cv2.COLOR_BGRA2BGR)
    return np.asarray(cv2.flip(bgr, 1), np.uint8)


def depth_picture(big_depth: NDArray[np.float32], width: int, height: int) -> NDArray[np.uint16]:
    """Registration's big depth picture as (``height``, ``width``) uint16 mm, 0 = invalid, aligned to colour; a copy.

    ``big_depth`` is (1082, 1920) float32 mm, mirrored, invalid = inf, with a blank row above and below. A smaller
    picture takes the value at each pixel's centre: a mean over an edge would be a depth that nothing has.
    """
    rows = _centres(height, HEIGHT) + 1
    columns = _centres(width, WIDTH)[::-1]
    depth = big_depth[rows[:, None], columns[None, :]]
    known = np.isfinite(depth) & (depth > 0) & (depth < np.iinfo(np.uint16).max)
    return np.where(known, np.rint(np.where(known, depth, 0)), 0).astype(np.uint16)


def camera_model(colour: Any, width: int, height: int) -> CameraModel:
    """The factory's intrinsics for the turned picture of this size, from the library's ``ColorCameraParams``.

    Its fx, fy, cx, cy (px, integer = pixel centre) are the mirrored picture's. It knows no distortion of the colour
    lens.
    """
    across, down = width / WIDTH, height / HEIGHT
    matrix = np.array(
        [
            [colour.fx * across, 0, (WIDTH - 1 - colour.cx + 0.5) * across - 0.5],
            [0, colour.fy * down, (colour.cy + 0.5) * down - 0.5],
            [0, 0, 1],
        ]
    )
    return CameraModel(width, height, matrix, np.zeros(5))


def lateness_ms(colour_ticks: int, depth_ticks: int) -> float:
    """By how much colour was taken later than depth (ms); right also where the clock has just begun anew."""
    apart = (colour_ticks - depth_ticks) % _TICKS
    return (apart - _TICKS if apart >= _TICKS // 2 else apart) * TICK_NS / 1e6


class TickClock:
    """The camera's clock as ns that go on where its 32 bits begin anew (after six days)."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._ticks = 0

    def ns(self, ticks: int) -> int:
        """The time of a frame's ``timestamp``."""
        if self._last is None:
            self._ticks = self._last = ticks
        step = (ticks - self._last) % _TICKS
        self._ticks += step if step < _TICKS // 2 else step - _TICKS
        self._last = ticks
        return self._ticks * TICK_NS


def _centres(wanted: int, given: int) -> NDArray[np.intp]:
    """Which of ``given`` pixels in a row lies at the centre of each of ``wanted`` ones."""
    return ((np.arange(wanted) + 0.5) * given / wanted).astype(np.intp)
