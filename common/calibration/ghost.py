"""The next pose to hold as an outline in the picture, and in what the board differs from it, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.boards import Board, outline, standing
from common.calibration.diversity import Stance
from common.calibration.start import pose_of
from common.calibration.views import View
from common.calibration.wishes import TILTS, Wish
from common.geometry import CameraModel, Pose

Array = NDArray[np.float64]
_SHARES = {-1: 0.28, 0: 0.45, 1: 0.8}
"""How much of the picture the board takes up, by ``Wish.nearer``."""
_FAR_OFF = 0.12
"""So far beside the ghost (as a share of the picture) a board has to be moved."""
_TILT_OFF_DEG = 12.0
_LARGER = 1.35
"""So much larger or smaller than the ghost (in length) it has to come nearer or go farther away."""


def ghost(board: Board, wish: Wish, camera: CameraModel) -> Array:
    """The corners TL TR BR BL (4, 2), px, of the board held as wished for; ``camera`` may be a guess."""
    pose = standing(
        board.size_mm, camera, place=wish.place, tilt_deg=wish.tilt_deg, towards_deg=wish.towards_deg,
        share=_SHARES[wish.nearer],
    )  # fmt: skip
    return camera.project(pose.apply(outline(board.size_mm)))[0]


def outline_of(board: Board, view: View, camera: CameraModel) -> Array:
    """The corners (4, 2), px, of the board as it is seen; NaN for one behind the camera."""
    pose = pose_of(view, camera)
    return camera.project(Pose.from_rvec(pose[:3], pose[3:]).apply(outline(board.size_mm)))[0]


def hints(seen: Array, stance: Stance, wish: Wish, wanted: Array, size: tuple[int, int]) -> tuple[str, ...]:
    """What to do with a board so that it gets from ``seen`` (4, 2) to ``wanted`` (4, 2), most important first."""
    found = [*_move(seen, wanted, size), *_turn(stance, wish)]
    ratio = float(np.sqrt(max(_area(wanted), 1.0) / max(_area(seen), 1.0)))
    if wish.nearer or not found:
        found += ["come nearer"] if ratio > _LARGER else ["go farther away"] if ratio < 1 / _LARGER else []
    return tuple(found)


def _move(seen: Array, wanted: Array, size: tuple[int, int]) -> list[str]:
    across, down = (wanted.mean(axis=0) - seen.mean(axis=0)) / np.array(size)
    ways = []
    if abs(across) > _FAR_OFF:
        ways.append("to the right" if across > 0 else "to the left")
    if abs(down) > _FAR_OFF:
        ways.append("down" if down > 0 else "up")
    return [f"move it {' and '.join(ways)} in the picture"] if ways else []


def _turn(stance: Stance, wish: Wish) -> list[str]:
    if wish.nearer or wish.code == "cover":
        return []
    if wish.tilt_deg == 0:
        return ["hold it straighter"] if stance.tilt_deg > _TILT_OFF_DEG else []
    side = min(TILTS, key=lambda tilt: abs((tilt[1] - wish.towards_deg + 180) % 360 - 180))[0]
    along = stance.tilt_deg * np.cos(np.radians(stance.towards_deg - wish.towards_deg))
    return [f"tilt it more to the {side}"] if along < wish.tilt_deg - _TILT_OFF_DEG else []


def _area(polygon: Array) -> float:
    """Of a polygon (n, 2), px^2; 0 where it has no finite one."""
    x, y = polygon.T
    area = float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)
    return area if np.isfinite(area) else 0.0
