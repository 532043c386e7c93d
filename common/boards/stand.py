"""Where a board stands so that a camera sees it at a place of the picture, so tilted, so large, and whole."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel, Pose

Array = NDArray[np.float64]
MARGIN = 0.02
"""Between board and picture's edge, as a share of the picture's width: a chessboard is only found whole."""
_ROUNDS = 6


def outline(size_mm: tuple[float, float]) -> Array:
    """The corners TL TR BR BL (4, 3) of a board of this size in its own frame, mm."""
    width, height = size_mm
    return np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], dtype=np.float64)


def standing(
    size_mm: tuple[float, float],
    camera: CameraModel,
    *,
    place: tuple[float, float] = (0.5, 0.5),
    tilt_deg: float = 0.0,
    towards_deg: float = 0.0,
    share: float = 0.45,
) -> Pose:
    """A pose (board frame to camera frame) in which all of the board is in the picture.

    ``place``: where its middle is wished to be (0..1 from the picture's top left); it is as near to that as the picture
    allows. ``tilt_deg``: between the board's normal and the optical axis; ``towards_deg``: the direction in the picture
    to which the normal then leans (0 right, 90 down). ``share``: how much of the picture's width (or height) it would
    take up if it weren't tilted.
    """
    lean = np.radians(towards_deg)
    axis = np.array([np.sin(lean), -np.cos(lean), 0.0]) * np.radians(tilt_deg)
    turn = np.asarray(cv2.Rodrigues(axis)[0], dtype=np.float64)
    corners = outline(size_mm)
    middle = turn @ corners.mean(axis=0)
    picture = np.array([camera.width, camera.height], dtype=np.float64)
    distance = float((np.diag(camera.matrix)[:2] * size_mm / (share * picture)).max())
    aim = np.array(place) * picture - 0.5
    margin = MARGIN * camera.width
    pose = Pose(turn, np.array([0.0, 0.0, distance]) - middle)
    for _ in range(_ROUNDS):
        ray = camera.normalise(aim[None])[0]
        if not np.isfinite(ray).all():
            ray = np.zeros(2)
        pose = Pose(turn, np.array([*(ray * distance), distance]) - middle)
        pixels, front = camera.project(pose.apply(corners))
        if not front.all():
            distance *= 1.5
            continue
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        grown = float(((high - low) / (picture - 2 * margin)).max())
        if grown > 1:
            distance *= grown * 1.02
        under, over = np.maximum(margin - low, 0), np.maximum(high - (picture - 1 - margin), 0)
        if grown <= 1 and not under.any() and not over.any():
            break
        aim = np.clip(aim + np.where(under > 0, under, -over), 0, picture - 1)
    return pose
