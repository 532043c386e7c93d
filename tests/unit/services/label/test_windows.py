from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import PoseError
from common.geometry import CORNER_NAMES, CameraModel, Pose
from services.label.windows import clip_near, clip_window, project_box, side_polygon
from tests.unit.services.label.truth import BOX, BOX_CORNERS, CAMERA, FISHEYE, camera, looking_at, project

PLAIN = camera((0, 0, 0, 0, 0))
BARREL = camera((-0.5, 0, 0, 0, 0))
TWO_TAGS = CameraModel(
    1920,
    1080,
    np.array([[2142.5, 0, 993.7], [0, 2142.7, 543.0], [0, 0, 1]]),
    np.array([0.514, -6.091, 0.001, 0.001, 19.87]),
)


@pytest.mark.parametrize("model", [CAMERA, PLAIN, FISHEYE], ids=["distorted", "plain", "fisheye"])
@pytest.mark.parametrize("view", [(0, 0), (35, 25), (-120, 10), (180, -30)])
def test_corners_and_window_as_cv2_projects_them(model, view):
    pose = looking_at(*view, 1100)
    found = project_box(BOX, pose, model)
    truth = project(BOX_CORNERS, pose, model)
    assert tuple(corner.name for corner in found.corners) == CORNER_NAMES
    np.testing.assert_allclose([(corner.x, corner.y) for corner in found.corners], truth, atol=1e-6)
    assert all(corner.in_image for corner in found.corners)
    window = found.window_unclipped
    np.testing.assert_allclose((window.x_min, window.y_min), truth.min(axis=0), atol=1e-6)
    np.testing.assert_allclose((window.x_max, window.y_max), truth.max(axis=0), atol=1e-6)
    assert found.window == window


def test_window_by_hand():
    # the front is 900 mm away: +-200 mm are +-204.8 px, +-150 mm are +-153.6 px
    window = project_box(BOX, looking_at(0, 0, 1000), PLAIN).window
    assert window is not None
    np.testing.assert_allclose(
        (window.x_min, window.y_min, window.x_max, window.y_max), (434.7, 205.9, 844.3, 513.1), atol=1e-9
    )


def test_partly_outside_is_clipped_to_the_pictures_area():
    found = project_box(BOX, looking_at(0, 0, 1000, (600, 300)), PLAIN)
    assert found.window_unclipped.x_max > 1280
    assert found.window is not None
    assert (found.window.x_max, found.window.y_max) == (1279.5, 719.5)
    assert found.window.x_min == found.window_unclipped.x_min
    by_name = {corner.name: corner for corner in found.corners}
    assert by_name["front_top_left"].in_image
    assert not by_name["front_bottom_right"].in_image
    assert by_name["front_bottom_right"].x > 1280


def test_wholly_outside_has_no_clipped_window():
    found = project_box(BOX, looking_at(0, 0, 1000, (3000, 0)), PLAIN)
    assert found.window is None
    assert found.window_unclipped.x_min > 1280
    assert not any(corner.in_image for corner in found.corners)


def test_corners_behind_the_camera_have_no_coordinates_and_edges_are_cut():
    # The camera stands 50 mm behind the plane of the box's front, to its left: the back is seen, the front isn't.
    pose = looking_at(0, 0, 50, (500, 0))
    found = project_box(BOX, pose, PLAIN)
    for corner in found.corners:
        if corner.name.startswith("front"):
            assert (corner.x, corner.y, corner.in_image) == (None, None, False)
        else:
            assert corner.x is not None
    # left edge: x = 300 mm at the back (z = 150); where the edges pass the near plane, x/z is huge
    assert found.window_unclipped.x_min == pytest.approx(639.5 + 921.6 * 300 / 150)
    assert found.window_unclipped.x_max > 100_000
    assert found.window is None


def test_camera_beside_the_box_sees_it_fill_the_picture():
    found = project_box(BOX, looking_at(0, 0, 100, (0, 0)), PLAIN)  # the front lies in the camera's plane
    assert found.window is not None
    assert (found.window.x_min, found.window.x_max) == (-0.5, 1279.5)


def test_wholly_behind_is_an_error_that_says_so():
    with pytest.raises(PoseError, match="box-1 lies wholly behind the camera") as raised:
        project_box(BOX, looking_at(0, 0, -1000), PLAIN)
    assert raised.value.code == "bad_pose"


def test_a_pose_that_is_not_finite_is_refused():
    with pytest.raises(PoseError, match="not finite"):
        project_box(BOX, Pose(np.eye(3), np.array([np.nan, 0, 1000])), PLAIN)


def test_clip_window_touching_the_edge_is_outside():
    inside = project_box(BOX, looking_at(0, 0, 1000), PLAIN).window_unclipped
    assert clip_window(inside, PLAIN) == inside
    shifted = inside.model_copy(update={"x_min": 1279.5, "x_max": 1400.0})
    assert clip_window(shifted, PLAIN) is None


def test_side_polygon_runs_clockwise_from_the_viewers_top_left():
    pose = looking_at(0, 0, 1000)
    polygon = side_polygon(BOX, "front", pose, PLAIN)
    np.testing.assert_allclose(polygon, [(434.7, 205.9), (844.3, 205.9), (844.3, 513.1), (434.7, 513.1)], atol=1e-9)


def test_side_polygon_is_cut_in_front_of_the_camera():
    polygon = side_polygon(BOX, "left", looking_at(0, 0, 50, (500, 0)), PLAIN)
    assert len(polygon) == 4
    assert np.isfinite(polygon).all()
    assert side_polygon(BOX, "front", looking_at(0, 0, 50, (500, 0)), PLAIN) == ()


def test_clip_near_keeps_what_is_in_front():
    square = np.array([[-1, -1, 5], [1, -1, 5], [1, 1, 5], [-1, 1, 5.0]])
    np.testing.assert_array_equal(clip_near(square), square)
    assert clip_near(square * (1, 1, -1)).shape == (0, 3)
    tilted = np.array([[0, 0, 3], [0, 0, -1], [1, 0, -1], [1, 0, 3.0]])
    clipped = clip_near(tilted)
    assert len(clipped) == 4
    assert clipped[:, 2].min() == 1.0


@settings(max_examples=300, deadline=None)
@given(
    model=st.sampled_from([CAMERA, PLAIN, BARREL, TWO_TAGS, FISHEYE]),
    rvec=st.tuples(*[st.floats(-3.1, 3.1)] * 3),
    tvec=st.tuples(st.floats(-3000, 3000), st.floats(-3000, 3000), st.floats(-600, 5000)),
)
def test_no_nonsense_whatever_the_pose(model, rvec, tvec):
    """Also behind, inside and very near: everything is finite or None, windows hold their corners."""
    pose = Pose.from_rvec(rvec, tvec)
    depths = pose.apply(BOX_CORNERS)[:, 2]
    try:
        found = project_box(BOX, pose, model)
    except PoseError:
        assert depths.max() < 1.0
        return
    window = found.window_unclipped
    assert np.isfinite([window.x_min, window.y_min, window.x_max, window.y_max]).all()
    for corner, depth in zip(found.corners, depths, strict=True):
        assert (corner.x is None) == (corner.y is None) == (depth < 1.0)
        if corner.x is None or corner.y is None:
            assert not corner.in_image
            continue
        assert window.x_min <= corner.x <= window.x_max
        assert window.y_min <= corner.y <= window.y_max
        assert corner.in_image == (-0.5 <= corner.x < model.width - 0.5 and -0.5 <= corner.y < model.height - 0.5)
    if found.window is not None:
        assert -0.5 <= found.window.x_min < found.window.x_max <= model.width - 0.5
        assert -0.5 <= found.window.y_min < found.window.y_max <= model.height - 0.5
    else:
        assert not any(corner.in_image for corner in found.corners)
    for side in BOX.sides:
        polygon = side_polygon(BOX, side.face, pose, model)
        assert len(polygon) != 1
        assert np.isfinite(np.array(polygon, dtype=float)).all()
