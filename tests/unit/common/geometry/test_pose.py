from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common.geometry import Pose

vectors = arrays(np.float64, 3, elements=st.floats(-1000, 1000))
turns = arrays(np.float64, 3, elements=st.floats(-3, 3))


def pose(rvec, tvec) -> Pose:
    return Pose.from_rvec(rvec, tvec)


def test_quarter_turn_about_z():
    quarter = pose([0, 0, np.pi / 2], [1, 2, 3])
    np.testing.assert_allclose(quarter.apply([[1, 0, 0]]), [[1, 3, 3]], atol=1e-12)


def test_after_applies_the_first_first():
    turn, shift = pose([0, 0, np.pi / 2], [0, 0, 0]), pose([0, 0, 0], [10, 0, 0])
    np.testing.assert_allclose(turn.after(shift).apply([0, 0, 0]), [[0, 10, 0]], atol=1e-12)
    np.testing.assert_allclose(shift.after(turn).apply([0, 0, 0]), [[10, 0, 0]], atol=1e-12)


def test_identity_changes_nothing():
    np.testing.assert_array_equal(Pose.identity().apply([[1, 2, 3]]), [[1, 2, 3]])


def test_angle_between_poses():
    assert np.isclose(pose([0.2, 0, 0], [0, 0, 0]).angle_to(pose([-0.3, 0, 0], [9, 9, 9])), 0.5)


@given(rvec=turns, tvec=vectors, point=vectors)
def test_there_and_back(rvec, tvec, point):
    there = pose(rvec, tvec)
    np.testing.assert_allclose(there.inverse().apply(there.apply(point)), [point], atol=1e-8)
    np.testing.assert_allclose(there.after(there.inverse()).matrix, np.eye(4), atol=1e-8)


@given(rvec=turns, tvec=vectors, point=vectors)
def test_matrix_does_what_apply_does(rvec, tvec, point):
    moved = pose(rvec, tvec)
    np.testing.assert_allclose((moved.matrix @ [*point, 1])[:3], moved.apply(point)[0], atol=1e-8)


@given(rvec=turns, tvec=vectors)
def test_label_round_trip(rvec, tvec):
    there = pose(rvec, tvec)
    label = there.label()
    back = Pose.from_label(label)
    np.testing.assert_array_equal(back.matrix, there.matrix)
    # cv2 writes angles under 1e-5 rad as zero
    np.testing.assert_allclose(cv2.Rodrigues(np.array(label.rvec))[0], there.rotation, atol=2e-5)
    assert label.tvec_mm == tuple(tvec)


@given(rvec=turns, tvec=vectors, first=vectors, second=vectors)
def test_distances_are_kept(rvec, tvec, first, second):
    moved = pose(rvec, tvec).apply([first, second])
    np.testing.assert_allclose(np.linalg.norm(moved[0] - moved[1]), np.linalg.norm(first - second), atol=1e-7)
