"""Boards of all kinds, rendered and found again; and what is said of pictures without one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.boards import Board
from common.calibration import BoardFinder, Miss, View
from common.geometry import CameraModel
from tests.unit.common.calibration.pictures import picture

CAMERA = CameraModel(
    480, 360, np.array([[420.0, 0, 242], [0, 421.5, 177], [0, 0, 1]]), np.array([-0.1, 0.03, 0.0005, -0.0005, 0])
)
CHESS = Board(kind="chessboard", columns=9, rows=6, square_mm=25)
CHARUCO = Board(kind="charuco", columns=7, rows=6, square_mm=30, marker_mm=21, family="4x4_50")
LEGACY = Board(kind="charuco", columns=7, rows=6, square_mm=30, marker_mm=21, family="4x4_50", legacy=True)
OTHER_IDS = Board(kind="charuco", columns=7, rows=6, square_mm=30, marker_mm=21, family="4x4_50", first_id=25)
OTHER_FAMILY = Board(kind="charuco", columns=7, rows=6, square_mm=30, marker_mm=21, family="6x6_50")
APRIL = Board(kind="charuco", columns=6, rows=5, square_mm=30, marker_mm=20, family="apriltag_36h11")
GRID = Board(kind="aprilgrid", columns=5, rows=4, marker_mm=32, gap_mm=8, family="apriltag_36h11")
ARUCO = Board(kind="aruco-grid", columns=5, rows=4, marker_mm=36, gap_mm=12, family="4x4_50")


def standing(board: Board, tilt: float = 20.0, across: float = 0.0, share: float = 0.7) -> NDArray[np.float64]:
    """The board's middle on the axis (or ``across`` of the picture beside it), tilted about an oblique line."""
    width, height = board.size_mm
    turn = np.asarray(cv2.Rodrigues(np.radians(tilt) * np.array([0.8, 0.6, 0.0]))[0])
    distance = CAMERA.matrix[0, 0] * width / (share * CAMERA.width)
    at = np.array([across * CAMERA.width / CAMERA.matrix[0, 0] * distance, 0, distance])
    return np.concatenate([cv2.Rodrigues(turn)[0].ravel(), at - turn @ [width / 2, height / 2, 0]])


def found(board: Board, pose: NDArray[np.float64], finder: BoardFinder | None = None) -> View | Miss:
    drawn = picture(board, CAMERA, pose, np.random.default_rng(1))
    return (finder or BoardFinder(board)).find(drawn, "rendered")


def errors(view: View, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    there = view.points @ np.asarray(cv2.Rodrigues(pose[:3])[0]).T + pose[3:]
    return view.corners - CAMERA.project(there)[0]


@pytest.mark.parametrize(
    "board", [CHESS, CHARUCO, LEGACY, APRIL, GRID, ARUCO], ids=["chess", "charuco", "legacy", "april", "grid", "aruco"]
)
def test_the_corners_of_a_board_are_found_where_they_are(board: Board) -> None:
    pose = standing(board)
    view = found(board, pose)
    assert isinstance(view, View), view
    assert set(view.ids.tolist()) <= set(board.points().ids.tolist())
    assert len(view.ids) >= 0.9 * len(board.points().ids)
    off = errors(view, pose)
    assert np.linalg.norm(off.mean(axis=0)) < 0.04
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.2
    assert 1.5 < view.edge_px < 3.0


@pytest.mark.parametrize("board", [CHARUCO, GRID], ids=["charuco", "grid"])
def test_a_part_of_a_board_is_a_view(board: Board) -> None:
    pose = standing(board, across=0.35)
    view = found(board, pose)
    assert isinstance(view, View), view
    assert 8 <= len(view.ids) < len(board.points().ids)
    assert np.linalg.norm(errors(view, pose), axis=1).max() < 0.4


def test_a_part_of_a_chessboard_is_none() -> None:
    miss = found(CHESS, standing(CHESS, across=0.35))
    assert isinstance(miss, Miss)
    assert miss.code == "no_board"
    assert "all of a chessboard must be in the picture" in miss.reason


def test_a_charuco_board_of_the_other_layout_is_told() -> None:
    miss = found(LEGACY, standing(LEGACY, tilt=5), BoardFinder(CHARUCO))
    assert isinstance(miss, Miss)
    assert miss.code == "wrong_layout"
    assert "layout (new) right?" in miss.reason


def test_a_board_of_another_family_or_with_other_ids_is_told() -> None:
    drawn = picture(CHARUCO, CAMERA, standing(CHARUCO), np.random.default_rng(1))
    miss = BoardFinder(OTHER_IDS).find(drawn, "other")
    assert isinstance(miss, Miss)
    assert (miss.code, "not the board's" in miss.reason) == ("no_board", True)
    miss = BoardFinder(OTHER_FAMILY).find(drawn, "other")
    assert isinstance(miss, Miss)
    assert "none of its markers (6x6_50) is seen" in miss.reason


def test_blur_is_told_whether_the_board_is_found_or_not() -> None:
    drawn = picture(CHESS, CAMERA, standing(CHESS), np.random.default_rng(1))
    soft = BoardFinder(CHESS).find(cv2.GaussianBlur(drawn, (0, 0), 3.0), "soft")
    assert isinstance(soft, View)
    assert soft.edge_px > 5.0
    gone = BoardFinder(CHESS).find(cv2.GaussianBlur(drawn, (0, 0), 30.0), "gone")
    assert isinstance(gone, Miss)
    assert gone.code == "blurred"


def test_a_bare_wall_has_no_board() -> None:
    for board in (CHESS, CHARUCO, GRID):
        miss = BoardFinder(board).find(np.full((360, 480), 128, dtype=np.uint8), "wall")
        assert isinstance(miss, Miss)
