"""The relative pose of two cameras against the truth, and whether its error bars are honest."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.boards import Board, standing
from common.calibration.extrinsics import Pair, Relative, Sight, relative_pose
from common.errors import RefusedError
from common.geometry import CameraModel, Pose

Array = NDArray[np.float64]
BOARD = Board(kind="chessboard", columns=9, rows=6, square_mm=25)
FIRST = CameraModel(
    1280, 720, np.array([[905.0, 0, 652], [0, 908.0, 351], [0, 0, 1]]), np.array([-0.18, 0.09, 0.0008, -0.0006, -0.02])
)
SECOND = CameraModel(
    640,
    480,
    np.array([[500.0, 0, 322], [0, 500.0, 236], [0, 0, 1]]),
    np.array([-0.02, 0.004, 0.001, 0.0]),
    model="fisheye",
)
TRUE = Pose.from_rvec([0.05, -0.45, 0.02], [310.0, -12.0, 90.0])
"""Second camera to first camera."""


def pairs(rng: np.random.Generator, count: int, noise_px: float = 0.15, fault_px: float = 0.0) -> list[Pair]:
    """Boards where the first camera sees them, as far as the second one does; ``fault_px``: common to a picture."""
    points, found = BOARD.points().mm, []
    while len(found) < count:
        pose = standing(
            BOARD.size_mm, FIRST, place=tuple(rng.uniform(0.2, 0.8, 2)), tilt_deg=float(rng.uniform(0, 40)),
            towards_deg=float(rng.uniform(0, 360)), share=float(rng.uniform(0.2, 0.4)),
        )  # fmt: skip
        sights = []
        for camera, placed in ((FIRST, pose), (SECOND, TRUE.inverse().after(pose))):
            pixels, front = camera.project(placed.apply(points))
            pixels += rng.normal(0, noise_px, pixels.shape) + rng.normal(0, fault_px, 2) if front.all() else 0
            inside = camera.contains(pixels)
            turned = Pose.from_rvec(placed.rvec + rng.normal(0, 0.02, 3), placed.translation + rng.normal(0, 5, 3))
            sights.append(Sight(points[inside], pixels[inside], turned))
        if all(len(sight.points) >= 20 for sight in sights):
            found.append(Pair(f"{len(found):02d}", *sights))
    return found


def error(found: Relative) -> Array:
    """Turn (rad, about the first camera's axes) and shift (mm) from the truth to what was found."""
    turn = np.asarray(cv2.Rodrigues(found.pose.rotation @ TRUE.rotation.T)[0]).ravel()
    return np.concatenate([turn, found.pose.translation - TRUE.translation])


@pytest.mark.parametrize("fault_px", [0.0, 0.3], ids=["white noise", "faults common to a picture"])
def test_the_truth_lies_within_three_deviations_which_are_honest_both_ways(fault_px: float) -> None:
    rng = np.random.default_rng(11)
    shares = []
    for _ in range(16):
        found = relative_pose(pairs(rng, 15, fault_px=fault_px), FIRST, SECOND)
        shares.append(error(found) / np.sqrt(np.diag(found.covariance)))
    assert (np.abs(shares) < 3).mean() >= 0.95
    assert 0.7 < float(np.sqrt(np.mean(np.square(shares)))) < 1.4


def test_it_is_as_exact_as_the_corners_allow() -> None:
    found = relative_pose(pairs(np.random.default_rng(2), 20), FIRST, SECOND)
    assert found.pairs == 20
    assert found.dropped == ()
    assert np.abs(error(found)[3:]).max() < 1.0
    assert found.rms_px == pytest.approx(0.15 * np.sqrt(2), rel=0.1)
    assert found.sd_mm.max() < 0.5
    assert found.sd_rotation_deg.max() < 0.05


def test_pairs_in_which_the_thing_moved_are_left_out_by_name() -> None:
    some = pairs(np.random.default_rng(3), 16)
    moved = some[4].second
    some[4] = Pair("moved", some[4].first, Sight(moved.points, moved.pixels + np.array([14.0, 3.0]), moved.pose))
    found = relative_pose(some, FIRST, SECOND)
    assert found.dropped == ("moved",)
    assert (np.abs(error(found)) < 4 * np.sqrt(np.diag(found.covariance))).all()


def test_cameras_may_see_different_points_of_the_thing() -> None:
    some = [
        Pair(one.name, _part(one.first, slice(0, None, 2)), _part(one.second, slice(1, None, 2)))
        for one in pairs(np.random.default_rng(4), 20)
    ]
    found = relative_pose(some, FIRST, SECOND)
    assert (np.abs(error(found)) < 4 * np.sqrt(np.diag(found.covariance))).all()


def test_too_few_pairs_are_refused() -> None:
    with pytest.raises(RefusedError, match="only 2 pairs"):
        relative_pose(pairs(np.random.default_rng(5), 2), FIRST, SECOND)


def _part(sight: Sight, which: slice) -> Sight:
    return Sight(sight.points[which], sight.pixels[which], sight.pose)
