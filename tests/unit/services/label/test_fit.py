from __future__ import annotations

import numpy as np
import pytest

from common.geometry import Pose
from services.label.fit import join, misfit, observe, refine, residual_px, square_poses
from tests.unit.services.label.truth import CAMERA, FISHEYE, MARKER_CORNERS, camera, looking_at, project

POSE = looking_at(30, 25, 900, (40, -20))


def observed(model, *ids, sigma=0.5):
    return join(
        [
            observe(
                np.array(MARKER_CORNERS[i], float), project(MARKER_CORNERS[i], POSE, model), np.full(4, sigma), model
            )
            for i in ids
        ]
    )


def nudged(pose: Pose, turn=0.1, shift=30.0) -> Pose:
    return Pose.from_rvec([turn, -turn, turn / 2], [shift, -shift, 2 * shift]).after(pose)


@pytest.mark.parametrize("model", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_finds_the_true_pose_through_any_lens(model):
    fit = refine(observed(model, 0, 1, 2), nudged(POSE))
    assert fit is not None
    np.testing.assert_allclose(fit.pose.matrix, POSE.matrix, atol=1e-4)
    assert fit.cost < 1e-6


def test_residuals_are_picture_pixels():
    shifted = observe(
        np.array(MARKER_CORNERS[0], float),
        np.add(project(MARKER_CORNERS[0], POSE), (3.0, 4.0)),
        np.full(4, 0.5),
        CAMERA,
    )
    assert residual_px(shifted, POSE) == pytest.approx(5.0, abs=0.02)
    assert misfit(shifted, POSE) == pytest.approx(4 * (5.0 / 0.5) ** 2, rel=0.01)


def test_information_predicts_the_scatter():
    """The inverse of ``information`` is the covariance of the fitted pose: checked by fitting 300 noisy copies."""
    random = np.random.default_rng(3)
    clean = observed(CAMERA, 0, 1)
    pixels = np.concatenate([project(MARKER_CORNERS[i], POSE) for i in (0, 1)])
    shifts = []
    for _ in range(300):
        noisy = observe(clean.points, pixels + random.normal(0, 0.5, (8, 2)), clean.sigma, CAMERA)
        fit = refine(noisy, POSE)
        assert fit is not None
        shifts.append(fit.pose.translation - POSE.translation)
    fit = refine(clean, POSE)
    assert fit is not None
    predicted = np.sqrt(np.diag(np.linalg.inv(fit.information))[3:])
    np.testing.assert_allclose(np.std(shifts, axis=0), predicted, rtol=0.2)


def test_behind_the_camera_fits_infinitely_badly():
    away = Pose(POSE.rotation, -POSE.translation)
    assert misfit(observed(CAMERA, 0), away) == float("inf")
    assert residual_px(observed(CAMERA, 0), away) == float("inf")
    assert refine(observed(CAMERA, 0), away) is None


def test_nan_starts_and_nan_corners_give_nothing():
    assert refine(observed(CAMERA, 0), Pose(POSE.rotation, np.array([np.nan, 0, 500]))) is None
    assert square_poses(np.full((4, 2), np.nan), 50) == ()


def test_one_of_the_two_square_poses_is_the_true_one():
    found = square_poses(CAMERA.normalise(project(MARKER_CORNERS[0], POSE)), 50)
    assert len(found) == 2
    centre = POSE.apply([0, -100, 0])[0]
    np.testing.assert_allclose(found[0].translation, centre, atol=0.01)
    # marker frame: x right, y up, z towards the viewer of the front, which are the box's X, Z and -Y
    np.testing.assert_allclose(
        found[0].rotation, POSE.rotation @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), atol=1e-4
    )


@pytest.mark.parametrize(
    "corners",
    [
        [(100, 100)] * 4,
        [(100, 100), (200, 100), (300, 100), (400, 100)],
        [(100, 100), (200, 200), (200, 100), (100, 200)],
    ],
    ids=["one point", "one line", "crossed"],
)
def test_degenerate_corners_give_finite_poses_or_none(corners):
    for pose in square_poses(CAMERA.normalise(np.array(corners, float)), 50):
        assert np.isfinite(pose.matrix).all()
        assert pose.translation[2] > 0


def test_a_camera_without_a_lens_has_the_slopes_of_the_smallest_one():
    pixels = project(MARKER_CORNERS[0], looking_at(20, 10, 700), camera((0.0,) * 5))
    none, small = (
        observe(np.array(MARKER_CORNERS[0], dtype=float), pixels, np.full(4, 0.1), camera((k1, 0, 0, 0, 0))).slopes
        for k1 in (0.0, 1e-12)
    )
    np.testing.assert_allclose(none, small, atol=1e-6)
