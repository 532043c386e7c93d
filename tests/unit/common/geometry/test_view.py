"""The direction from which an object is looked at, against cameras that are put there by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from common.geometry import Pose, view_direction


def looking_from(place: tuple[float, float, float], roll_deg: float = 0.0) -> Pose:
    """Object to camera for a camera at ``place`` (object frame, mm) that looks at the object's centre."""
    forward = -np.array(place) / np.linalg.norm(place)
    helper = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, helper)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    turn = math.radians(roll_deg)
    x = math.cos(turn) * right + math.sin(turn) * down
    rotation = np.array([x, np.cross(forward, x), forward])
    return Pose(rotation, -rotation @ np.array(place))


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((0, -900, 0), (0, 0)),
        ((900, 0, 0), (90, 0)),
        ((-900, 0, 0), (-90, 0)),
        ((0, 900, 0), (180, 0)),
        ((500, -500, 0), (45, 0)),
        ((0, -700, 700), (0, 45)),
        ((0, -700, -700), (0, -45)),
    ],
)
@pytest.mark.parametrize("roll_deg", [0.0, 30.0, 180.0])
def test_directions(place: tuple[float, float, float], expected: tuple[float, float], roll_deg: float) -> None:
    assert view_direction(looking_from(place, roll_deg).label().matrix) == pytest.approx(expected, abs=1e-9)


def test_straight_above_and_below() -> None:
    for z, elevation in ((800.0, 90.0), (-800.0, -90.0)):
        assert view_direction(looking_from((0.0, 0.0, z)).label().matrix)[1] == pytest.approx(elevation)
    still = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert view_direction(still) == (0.0, 0.0)
