"""A board in the scene is where its pose says, is held still, and comes to all parts of the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from common.boards import Board, outline
from common.calibration import BoardFinder, View
from common.geometry import CameraModel
from common.markers import family
from common.scene import BOARD, Scene, SceneCamera
from common.scene.boards import HOLD_FRAMES, MOVE_FRAMES

STOP = HOLD_FRAMES + MOVE_FRAMES
CAMERA = CameraModel(
    640,
    480,
    np.array([[460.0, 0, 319.5], [0, 460.0, 239.5], [0, 0, 1]]),
    np.array([0.08, -0.15, 0.0005, -0.0005, 0.05]),
)
BOARDS = {
    "charuco": Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250"),
    "chessboard": Board(kind="chessboard", columns=9, rows=6, square_mm=25),
    "aprilgrid": Board(kind="aprilgrid", columns=6, rows=4, marker_mm=40, gap_mm=12, family="apriltag_36h11"),
}


def scene_of(board: Board) -> Scene:
    frustum = (CAMERA.width / 2 / 460, CAMERA.height / 2 / 460)
    return Scene((), family("apriltag_36h11", Path()), 3, frustum=frustum, board=board)


@pytest.mark.parametrize("kind", BOARDS)
def test_its_corners_are_where_its_pose_puts_them(kind: str) -> None:
    board = BOARDS[kind]
    camera = SceneCamera(scene_of(board), CAMERA)
    finder, points = BoardFinder(board), board.points()
    errors = []
    for stop in range(3):
        rendered = camera.render(stop * STOP, noise=1.0)
        view = finder.find(rendered.bgr, "frame")
        assert isinstance(view, View)
        pose = camera.poses(stop * STOP)[BOARD]
        expected, _ = CAMERA.project(pose.apply(points.mm[np.searchsorted(points.ids, view.ids)]))
        errors.append(view.corners - expected)
        assert rendered.depth is not None
        inside = CAMERA.contains(expected)
        across, down = expected[inside][0].round().astype(int)
        assert rendered.depth[down, across] == pytest.approx(pose.apply(view.points[inside][0])[0, 2], abs=6)
        assert rendered.truth == ()
    off = np.concatenate(errors)
    # A search may put a corner of a small tag beside it; that is not the renderer's.
    near = np.linalg.norm(off, axis=1) < 0.6
    assert near.mean() > 0.85
    off = off[near]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.2
    assert np.abs(off.mean(axis=0)).max() < 0.03


def test_it_is_held_still_then_moves_to_another_pose() -> None:
    scene = scene_of(BOARDS["charuco"])
    start = scene.poses(0)[BOARD]
    assert np.allclose(scene.poses(HOLD_FRAMES)[BOARD].matrix, start.matrix)
    assert not np.allclose(scene.poses(HOLD_FRAMES + 3)[BOARD].matrix, start.matrix)
    before, after = scene.poses(STOP - 0.001)[BOARD], scene.poses(STOP)[BOARD]
    assert np.allclose(before.matrix, after.matrix, atol=0.01)


def test_all_of_it_is_in_the_picture_and_it_comes_everywhere() -> None:
    board = BOARDS["charuco"]
    scene = scene_of(board)
    flat = CameraModel(640, 480, CAMERA.matrix, np.zeros(5))
    middles = []
    for stop in range(45):
        pixels, _ = flat.project(scene.poses(stop * STOP)[BOARD].apply(outline(board.size_mm)))
        assert flat.contains(pixels).all()
        middles.append(pixels.mean(axis=0))
    assert np.ptp(middles, axis=0)[0] > 250
    assert np.ptp(middles, axis=0)[1] > 130


def test_the_same_seed_gives_the_same_path() -> None:
    first, second = scene_of(BOARDS["charuco"]), scene_of(BOARDS["charuco"])
    for index in (0.0, 60.0, 500.5):
        assert np.array_equal(first.poses(index)[BOARD].matrix, second.poses(index)[BOARD].matrix)
