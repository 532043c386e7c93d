from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.geometry import Pose
from services.label.pose import solve_box
from services.label.sightings import GAP_NS, SEEN_NS, Expected, Sighting, Sightings, in_view
from services.label.uncertainty import of_spread
from services.label.visible_objects import sort_markers
from tests.unit.services.label.truth import BOX, CAMERA, looking_at, seen

MS = 1_000_000
SURE = np.diag([1e-8] * 3 + [1e-2] * 3)


def found(pose: Pose):
    marker = sort_markers(seen(0, pose=looking_at(30, 20, 900)), [BOX]).objects[0]
    return replace(solve_box(BOX, marker.markers, CAMERA, 6.0), pose=pose)


def between(first: Pose, second: Pose, share: float, gap_ns: int = 100 * MS) -> Expected:
    at = int(share * gap_ns)
    return Expected("box-1", at, Sighting(0, first, SURE), None, Sighting(gap_ns, second, SURE))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_half_way_in_time_is_half_way_in_place_and_turn(share):
    pose, _ = between(looking_at(10, 20, 900), looking_at(30, 20, 1100, (100, 0)), share).between()
    wanted = looking_at(10 + 20 * share, 20, 900 + 200 * share, (100 * share, 0))
    np.testing.assert_allclose(pose.translation, wanted.translation, atol=1e-6)
    assert pose.angle_to(wanted) < np.radians(0.01)


def test_nothing_is_interpolated_over_a_long_gap_or_a_wide_turn():
    assert between(looking_at(0, 0, 900), looking_at(5, 0, 900), 0.5, GAP_NS + 1).between() is None
    assert between(looking_at(0, 0, 900), looking_at(70, 0, 900), 0.5).between() is None
    assert Expected("box-1", 5, Sighting(0, looking_at(0, 0, 900), SURE)).between() is None


def test_the_error_bar_grows_with_the_way_and_the_time():
    def bar(second: Pose, share: float, gap_ns: int) -> float:
        pose, spread = between(looking_at(10, 20, 900), second, share, gap_ns).between()
        return of_spread(BOX, pose, spread, CAMERA).distance_mm

    still, moving = looking_at(10, 20, 900), looking_at(10, 20, 1000)
    assert bar(moving, 0.5, 300 * MS) > bar(still, 0.5, 300 * MS) > bar(still, 0.5, 66 * MS)
    assert bar(moving, 0.5, 300 * MS) > bar(moving, 0.1, 300 * MS)


def test_a_motion_is_carried_on_for_a_while():
    way = Expected(
        "box-1",
        200 * MS,
        Sighting(100 * MS, looking_at(20, 0, 900, (10, 0)), SURE),
        Sighting(0, looking_at(10, 0, 900), SURE),
    )
    assert way.guess().angle_to(looking_at(30, 0, 900)) < np.radians(0.1)
    np.testing.assert_allclose(way.guess().translation, [20, 0, 900], atol=1e-6)
    later = replace(way, time_ns=100 * MS + 900 * MS)
    np.testing.assert_allclose(later.guess().translation, [40, 0, 900], atol=1e-6)  # 0.3 s and no further


def test_what_was_seen_before_and_after():
    seen_at = Sightings()
    for time in (0, 33, 66, 100, 200):
        seen_at.saw("cam0", "box-1", time * MS, found(looking_at(10, 0, 900 + time)))
    item = seen_at.expected("cam0", "box-1", 150 * MS)
    assert (item.before.time_ns, item.after.time_ns) == (100 * MS, 200 * MS)
    assert item.earlier.time_ns == 33 * MS  # far enough back to tell a velocity
    same = seen_at.expected("cam0", "box-1", 100 * MS)
    assert (same.before.time_ns, same.after.time_ns) == (66 * MS, 200 * MS)  # never the frame itself
    assert seen_at.expected("cam1", "box-1", 150 * MS) is None
    assert seen_at.expected("cam0", "box-2", 150 * MS) is None
    assert seen_at.expected("cam0", "box-1", 200 * MS + SEEN_NS + 1) is None


def test_in_view_is_neither_outside_nor_behind_another():
    assert in_view(BOX, looking_at(10, 10, 1500), CAMERA, [])
    assert not in_view(BOX, looking_at(10, 10, 1500, (3000, 0)), CAMERA, [])
    assert not in_view(BOX, looking_at(10, 10, -500), CAMERA, [])
    assert not in_view(BOX, looking_at(10, 10, 4000), CAMERA, [(BOX, looking_at(0, 0, 900))])
