"""Depth on markers and around them."""

from __future__ import annotations

import numpy as np
import pytest

from common.quality.depth_holes import depth_at_markers, punched

SQUARE = np.array([[40.0, 40], [59, 40], [59, 59], [40, 59]])


def test_a_marker_without_depth_is_a_hole_and_a_picture_full_of_holes_is_not() -> None:
    depth = np.full((100, 120), 1500, np.uint16)
    assert depth_at_markers(depth, [SQUARE]) == (1.0, 1.0)
    depth[40:60, 40:60] = 0
    assert depth_at_markers(depth, [SQUARE]) == (0.0, 1.0)
    assert punched(0.0, 1.0)
    assert not punched(0.0, 0.1), "there is no depth anyway"
    assert not punched(0.85, 1.0), "some noise is usual"


def test_shares_are_of_all_markers_together() -> None:
    depth = np.full((100, 120), 1500, np.uint16)
    depth[40:60, 40:60] = 0
    on, around = depth_at_markers(depth, [SQUARE, SQUARE + np.array([40, 20])]) or (0.0, 0.0)
    assert on == pytest.approx(0.5)
    assert around == 1.0


def test_a_neighbour_is_no_surroundings() -> None:
    depth = np.full((100, 120), 1500, np.uint16)
    depth[40:60, 40:80] = 0
    assert depth_at_markers(depth, [SQUARE, SQUARE + np.array([20, 0])]) == (0.0, 1.0)


def test_without_a_marker_in_the_picture_nothing_is_said() -> None:
    depth = np.zeros((100, 120), np.uint16)
    assert depth_at_markers(depth, []) is None
    assert depth_at_markers(depth, [SQUARE + 500]) is None
