"""The box against design.md's table, written out here by hand and not derived from the code under test."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.geometry import CORNER_NAMES, EDGES, FACES, Box, BoxSide, MarkerOnSide, marker_points

W, H, D = 400.0, 300.0, 200.0

# face: normal, right, up (object frame: X right, Y away, Z up), its width, height, depth as its viewer sees them
TABLE = {
    "front": ((0, -1, 0), (1, 0, 0), (0, 0, 1), (W, H, D)),
    "back": ((0, 1, 0), (-1, 0, 0), (0, 0, 1), (W, H, D)),
    "left": ((-1, 0, 0), (0, -1, 0), (0, 0, 1), (D, H, W)),
    "right": ((1, 0, 0), (0, 1, 0), (0, 0, 1), (D, H, W)),
    "top": ((0, 0, 1), (1, 0, 0), (0, 1, 0), (W, D, H)),
    "bottom": ((0, 0, -1), (1, 0, 0), (0, -1, 0), (W, D, H)),
}

CORNERS = {
    "front_top_left": (-200, -100, 150),
    "front_top_right": (200, -100, 150),
    "front_bottom_right": (200, -100, -150),
    "front_bottom_left": (-200, -100, -150),
    "back_top_left": (-200, 100, 150),
    "back_top_right": (200, 100, 150),
    "back_bottom_right": (200, 100, -150),
    "back_bottom_left": (-200, 100, -150),
}

# Each face's corners as its viewer names them, TL TR BR BL, by the names of the box's corners.
FACE_CORNERS = {
    "front": ("front_top_left", "front_top_right", "front_bottom_right", "front_bottom_left"),
    "back": ("back_top_right", "back_top_left", "back_bottom_left", "back_bottom_right"),
    "left": ("back_top_left", "front_top_left", "front_bottom_left", "back_bottom_left"),
    "right": ("front_top_right", "back_top_right", "back_bottom_right", "front_bottom_right"),
    "top": ("back_top_left", "back_top_right", "front_top_right", "front_top_left"),
    "bottom": ("front_bottom_left", "front_bottom_right", "back_bottom_right", "back_bottom_left"),
}


def box(*sides: BoxSide) -> Box:
    return Box("box-1", "box", (W, H, D), sides)


def test_there_are_the_six_faces_of_the_table():
    assert set(FACES) == set(TABLE)


@pytest.mark.parametrize("face", TABLE)
def test_face_axes(face):
    normal, right, up, size = TABLE[face]
    assert (FACES[face].normal, FACES[face].right, FACES[face].up) == (normal, right, up)
    assert box().face_size(face) == size
    np.testing.assert_array_equal(np.cross(right, up), normal)  # right-handed: x right, y up, z to the viewer


@pytest.mark.parametrize("face", TABLE)
def test_face_frame_lies_in_the_middle_of_the_face(face):
    normal, right, up, size = TABLE[face]
    pose = box().face_pose(face)
    np.testing.assert_allclose(pose.translation, np.array(normal) * size[2] / 2)
    np.testing.assert_allclose(pose.apply([[1, 0, 0]])[0] - pose.translation, right)
    np.testing.assert_allclose(pose.apply([[0, 1, 0]])[0] - pose.translation, up)


def test_corners_by_name():
    assert tuple(CORNERS) == CORNER_NAMES
    np.testing.assert_array_equal(box().corners, list(CORNERS.values()))


@pytest.mark.parametrize("face", FACE_CORNERS)
def test_face_polygon(face):
    np.testing.assert_allclose(box().face_polygon(face), [CORNERS[name] for name in FACE_CORNERS[face]])


def test_edges_are_the_twelve_that_differ_in_one_coordinate():
    corners = np.array(list(CORNERS.values()))
    assert len({frozenset(edge) for edge in EDGES}) == 12
    for first, second in EDGES:
        assert np.count_nonzero(corners[first] - corners[second]) == 1


def test_marker_points_are_top_left_first_then_clockwise():
    np.testing.assert_array_equal(marker_points(50), [[-25, 25, 0], [25, 25, 0], [25, -25, 0], [-25, -25, 0]])


def test_marker_with_offset_on_the_left_side():
    # 20 mm to the viewer's right (towards the front: -Y), 35 mm down, 3 mm out (towards -X)
    side = BoxSide("left", "left", (MarkerOnSide(1, 50, 10, (20, -35, 3)),))
    on_box = box(side)
    np.testing.assert_allclose(
        on_box.marker_corners(side, side.markers[0]),
        [[-203, 5, -10], [-203, -45, -10], [-203, -45, -60], [-203, 5, -60]],
    )


def test_rotation_is_counter_clockwise_for_the_viewer_and_does_not_turn_the_offset():
    side = BoxSide("front", "front", (MarkerOnSide(1, 50, 10, (20, 0, 0), rotation_deg=90),))
    corners = box(side).marker_corners(side, side.markers[0])
    # turned left by a quarter: the marker's top-left is now at the viewer's bottom left
    np.testing.assert_allclose(corners, [[-5, -100, -25], [-5, -100, 25], [45, -100, 25], [45, -100, -25]], atol=1e-9)


def test_marker_on_top_has_its_bottom_edge_at_the_front():
    side = BoxSide("lid", "top", (MarkerOnSide(2, 50),))
    corners = box(side).marker_corners(side, side.markers[0])
    np.testing.assert_allclose(corners, [[-25, 25, 150], [25, 25, 150], [25, -25, 150], [-25, -25, 150]])


def test_widened_marker():
    side = BoxSide("front", "front", (MarkerOnSide(1, 50, 10),))
    corners = box(side).marker_corners(side, side.markers[0], widen_mm=10)
    np.testing.assert_allclose(corners[0], [-35, -100, 35])


def test_all_markers_with_their_sides():
    front = BoxSide("front", "front", (MarkerOnSide(1, 50), MarkerOnSide(2, 30)))
    lid = BoxSide("lid", "top", (MarkerOnSide(3, 50),))
    assert [(side.class_name, marker.id) for side, marker in box(front, lid).markers()] == [
        ("front", 1),
        ("front", 2),
        ("lid", 3),
    ]


@given(
    size=st.tuples(*[st.floats(1, 5000)] * 3),
    face=st.sampled_from(sorted(TABLE)),
    offset=st.tuples(*[st.floats(-100, 100)] * 3),
    turn=st.floats(-720, 720),
)
def test_markers_stay_squares_in_their_plane(size, face, offset, turn):
    side = BoxSide("side", face, (MarkerOnSide(1, 40, 5, offset, turn),))
    any_box = Box("b", "box", size, (side,))
    corners = any_box.marker_corners(side, side.markers[0])
    normal = np.array(TABLE[face][0])
    np.testing.assert_allclose(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1), 40, rtol=1e-6)
    np.testing.assert_allclose(corners @ normal, any_box.face_size(face)[2] / 2 + offset[2], atol=1e-6)
    # clockwise for the viewer, whatever the turn
    assert np.cross(corners[1] - corners[0], corners[2] - corners[1]) @ normal < 0
