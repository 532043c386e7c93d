"""Reported deviations against true errors, over trials with known cameras."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.calibration import calibrate
from common.calibration.adjust import Adjusted
from common.calibration.candidates import settled
from common.calibration.engine import ALL_MODELS
from common.calibration.lens import CORE, LENSES
from common.calibration.start import first_guess, pose_of
from common.calibration.uncertainty import projection_map, uncertainty
from common.geometry import CameraModel
from tests.unit.common.calibration.synthetic import Camera

Array = NDArray[np.float64]
CAMERA = Camera(noise_px=0.1)


def truth(camera: Camera) -> Array:
    matrix = camera.model.matrix
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])


def fitted(camera: Camera, seed: int, count: int, *, lens: str = "5", flat: bool = True) -> Adjusted:
    views = camera.good_views(np.random.default_rng(seed), count)
    model = LENSES[lens]
    plain, theta = first_guess(views, fisheye=model.fisheye)
    theta = model.from_other(plain, theta)
    guess = model.camera(theta, views[0].size)
    return settled(views, model, theta, np.array([pose_of(view, guess) for view in views]), flat=flat)


def check_spread(errors: Array, deviations: Array) -> None:
    """Within three deviations in 95 % of the trials, and their spread 0.8 to 1.25 times the reported one."""
    assert (np.abs(errors) <= 3 * deviations).all(axis=1).mean() >= 0.95
    ratio = np.sqrt((errors**2).mean(axis=0) / (deviations**2).mean(axis=0))
    assert ((ratio > 0.8) & (ratio < 1.25)).all(), ratio


@pytest.mark.parametrize("lens", ["2", "5", "8", "fisheye"])
def test_derivatives_are_those_of_the_projection(lens: str) -> None:
    model = LENSES[lens]
    theta = np.array([900.0, 905, 640, 350, *np.linspace(0.02, -0.03, len(model.free))])
    pose = np.array([0.2, -0.3, 0.1, 30.0, -20, 600])
    points = Camera().points()
    pixels, by_theta, by_pose, by_point = model.project(theta, pose, points)
    for index in range(len(theta)):
        step = np.zeros(len(theta))
        step[index] = 1e-5
        moved = model.project(theta + step, pose, points)[0]
        assert np.allclose((moved - pixels) / 1e-5, by_theta[:, :, index], rtol=1e-3, atol=2e-2)
    for index in range(6):
        step = np.zeros(6)
        step[index] = 1e-6
        moved = model.project(theta, pose + step, points)[0]
        assert np.allclose((moved - pixels) / 1e-6, by_pose[:, :, index], rtol=1e-3, atol=2e-2)
    assert np.allclose(by_point, by_pose[:, :, 3:])


def test_deviations_are_honest_both_ways() -> None:
    fits = [fitted(CAMERA, seed, 16) for seed in range(12)]
    errors = np.array([fit.theta[:CORE] - truth(CAMERA) for fit in fits])
    deviations = np.array([uncertainty(fit).sd[:CORE] for fit in fits])
    assert (np.abs(errors) <= 3 * deviations).all(axis=1).mean() >= 0.95
    # So few trials fix the spread of all four together, not of each.
    assert 0.8 < np.sqrt((errors**2 / deviations**2).mean()) < 1.25


def test_deviations_grow_when_the_errors_of_a_picture_hang_together() -> None:
    """Corners of each view shifted by a smooth field, as blur or a board bent otherwise would."""
    rng = np.random.default_rng(3)
    views = CAMERA.good_views(rng, 20)
    for view in views:
        shape = view.points[:, :2] / view.points[:, :2].max()
        view.corners[:] += 0.3 * np.column_stack([shape, shape**2]) @ rng.normal(size=(4, 2))
    model = LENSES["5"]
    plain, theta = first_guess(views)
    theta = model.from_other(plain, theta)
    poses = np.array([pose_of(view, model.camera(theta, views[0].size)) for view in views])
    fit = settled(views, model, theta, poses, flat=True)
    assert uncertainty(fit).design_effect > 2.0


def test_a_bent_board_is_noticed() -> None:
    bent = Camera(noise_px=0.1, warp_mm=(0.8, -0.3))
    fit = fitted(bent, 1, 20, flat=False)
    assert np.allclose(fit.warp, bent.warp_mm, atol=4 * float(uncertainty(fit).sd[-2:].max()))
    assert abs(fit.theta[0] - 905.0) < 4 * uncertainty(fit).sd[0]
    outcome = calibrate(bent.good_views(np.random.default_rng(1), 20), models=("5",))
    assert outcome.solution is not None
    assert not outcome.solution.chosen.flat


def shown_px(camera: CameraModel, other: CameraModel) -> float:
    """The worst pixel's distance between two distortions, both under the first one's matrix."""
    grid = np.stack(np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 719, 19)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([camera.normalise(grid), np.ones(len(grid))])
    none = np.zeros(3)
    drawn = [cv2.projectPoints(rays, none, none, camera.matrix, one.distortion)[0] for one in (camera, other)]
    return float(np.linalg.norm((drawn[0] - drawn[1]).reshape(-1, 2), axis=1).max())


@pytest.mark.parametrize("seed", [1, 2])
def test_distortion_is_right_to_half_a_pixel_in_the_worst_pixel(seed: int) -> None:
    fit = fitted(CAMERA, seed, 40)
    assert shown_px(CAMERA.model, fit.lens.camera(fit.theta, (1280, 720))) < 0.5


def test_a_fisheye_is_recovered() -> None:
    camera = Camera(noise_px=0.1).as_model(np.array([0.03, -0.02, 0.01, -0.004]), "fisheye")
    fit = fitted(camera, 2, 20, lens="fisheye")
    assert (np.abs(fit.theta[:CORE] - truth(camera)) < 4 * uncertainty(fit).sd[:CORE]).all()


def test_a_projection_is_as_uncertain_as_the_map_says() -> None:
    """A point fixed to the boards, as the map has it: how far true and fitted cameras project it apart."""
    place, squares = np.array([200.0, 150.0]), []
    for seed in range(10):
        true_poses = [pose for _, pose in CAMERA.posed_views(np.random.default_rng(seed), 12)]
        fit = fitted(CAMERA, seed, 12)
        ray = np.array([*fit.lens.camera(fit.theta, (1280, 720)).normalise(place[None])[0], 1.0])
        point = ray / np.linalg.norm(ray) * 500.0
        carried = []
        for pose, true in zip(fit.poses, true_poses, strict=True):
            turn, true_turn = (np.asarray(cv2.Rodrigues(one[:3])[0]) for one in (pose, true))
            carried.append(true_turn @ turn.T @ (point - pose[3:]) + true[3:])
        apart = CAMERA.model.project(np.mean(carried, axis=0)[None])[0][0] - place
        # Of three columns and rows over (401, 301) px, the middle one is the pixel asked for.
        around = projection_map(fit, uncertainty(fit), (401, 301), 500.0, columns=3, rows=3)
        squares.append(float((apart**2).sum()) / float(around.sd_px[1, 1] ** 2))
    # The map gives the worst direction, so the mean square is one to two of its variances.
    assert 0.5 < np.mean(squares) < 2.8


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_hundred_calibrations_are_honest() -> None:
    """The whole engine, with its choice of model and warp."""
    errors, deviations, worst = [], [], []
    for seed in range(100):
        outcome = calibrate(CAMERA.good_views(np.random.default_rng(seed), 40), models=ALL_MODELS)
        solution = outcome.solution
        assert solution is not None
        assert outcome.verdict.level == "good", outcome.verdict.sentence
        errors.append(solution.fit.theta[:CORE] - truth(CAMERA))
        deviations.append(solution.uncertainty.sd[:CORE])
        worst.append(shown_px(CAMERA.model, solution.camera))
    check_spread(np.array(errors), np.array(deviations))
    assert max(worst) < 0.5
