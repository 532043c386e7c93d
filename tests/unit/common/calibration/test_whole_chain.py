"""Rendered pictures through the whole chain: found, fitted, judged."""

from __future__ import annotations

import numpy as np
import pytest

from common.boards import Board
from common.calibration import BoardFinder, View, calibrate
from common.geometry import CameraModel
from tests.unit.common.calibration.pictures import picture
from tests.unit.common.calibration.synthetic import Camera

CAMERA = CameraModel(
    640, 480, np.array([[560.0, 0, 322], [0, 562, 236], [0, 0, 1]]), np.array([-0.1, 0.03, 0.0005, -0.0005, 0])
)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_rendered_charuco_pictures_give_the_camera_they_were_rendered_with() -> None:
    board = Board(kind="charuco", columns=10, rows=7, square_mm=25, marker_mm=18, family="4x4_50")
    poses = Camera(model=CAMERA).posed_views(np.random.default_rng(3), 20)
    views = []
    for number, (_, pose) in enumerate(poses):
        drawn = picture(board, CAMERA, pose, np.random.default_rng(number))
        view = BoardFinder(board).find(drawn, f"{number}")
        if isinstance(view, View):
            views.append(view)
    assert len(views) >= 15
    solution = calibrate(views, models=("2", "5")).solution
    assert solution is not None
    true = np.array([560.0, 562, 322, 236])
    assert (np.abs(solution.fit.theta[:4] - true) < 3 * solution.uncertainty.sd[:4]).all()
    assert solution.uncertainty.sd[0] < 1.5
