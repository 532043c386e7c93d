from __future__ import annotations

import numpy as np
import pytest

from common.geometry import Box, Pose
from services.label.visibility import faces_camera, marker_angle, marker_hidden, viewing_angle
from tests.unit.services.label.truth import BOX, looking_at

PLACES = {marker.id: (side, marker) for side, marker in BOX.markers()}


def facing(pose: Pose) -> set[int]:
    return {id_ for id_, (side, marker) in PLACES.items() if faces_camera(pose, BOX, side, marker)}


@pytest.mark.parametrize(
    ("yaw", "pitch", "ids"),
    [(0, 0, {0}), (40, 0, {0, 1}), (-40, 0, {0, 3}), (40, 30, {0, 1, 2}), (180, 0, {4}), (140, 20, {1, 2, 4})],
)
def test_which_sides_face_the_camera(yaw, pitch, ids):
    assert facing(looking_at(yaw, pitch, 1500)) == ids


def test_perspective_counts_not_just_the_angle():
    # At 500 mm a side that is turned by 15 degrees is still seen from behind: its plane passes the camera.
    assert facing(looking_at(15, 0, 500)) == {0}
    assert facing(looking_at(15, 0, 3000)) == {0, 1}


def test_viewing_angle_by_hand():
    straight = looking_at(0, 0, 1000)
    assert viewing_angle(straight, "front", np.array([0, -100.0, 0])) == pytest.approx(0)
    assert viewing_angle(looking_at(30, 0, 1000), "front", np.zeros(3)) == pytest.approx(30)
    # to the side by as much as it is away: the sight line comes in at 45 degrees
    assert viewing_angle(looking_at(0, 0, 1000, (900, 0)), "front", np.array([0, -100.0, 0])) == pytest.approx(45)
    assert marker_angle(looking_at(180, 0, 1000), BOX, *PLACES[0]) == pytest.approx(180)


def test_a_surface_does_not_hide_itself():
    pose = looking_at(35, 25, 900)
    for id_ in (0, 1, 2):
        assert not marker_hidden(pose, BOX, *PLACES[id_], [(BOX, pose)])
    assert marker_hidden(pose, BOX, *PLACES[4], [(BOX, pose)])


def test_a_marker_half_covered_is_not_hidden():
    pose = looking_at(0, 0, 1000)
    wall = Box("wall", "box", (100.0, 400.0, 10.0), ())
    assert not marker_hidden(pose, BOX, *PLACES[0], [(wall, looking_at(0, 0, 500, (50, 0)))])
    assert marker_hidden(pose, BOX, *PLACES[0], [(wall, looking_at(0, 0, 500))])
