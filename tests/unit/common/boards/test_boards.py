"""Calibration boards: OpenCV's own layout is the yardstick where OpenCV knows the kind, Kalibr's description else."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from common.boards import Board, read_board, write_board
from common.boards.outlines import outlines
from common.errors import ConfigError
from common.markers import family

PX_PER_MM = 4


def chessboard(columns: int = 9, rows: int = 6, **more: object) -> Board:
    return Board.model_validate({"kind": "chessboard", "columns": columns, "rows": rows, "square_mm": 25.0, **more})


def charuco(columns: int = 5, rows: int = 7, **more: object) -> Board:
    options = {"kind": "charuco", "columns": columns, "rows": rows, "square_mm": 20.0, "marker_mm": 15.0}
    return Board.model_validate(options | {"family": "5x5_100"} | more)


def grid(kind: str = "aruco-grid", **more: object) -> Board:
    options = {"kind": kind, "columns": 4, "rows": 3, "marker_mm": 24.0, "gap_mm": 6.0, "family": "4x4_50"}
    return Board.model_validate(options | more)


def painted(board: Board, px_per_mm: int = PX_PER_MM) -> NDArray[np.uint8]:
    """The board by its outlines; a pixel for each 1/px_per_mm, no margin."""
    width, height = (round(value * px_per_mm) for value in board.size_mm)
    out = np.zeros((height, width), dtype=bool)
    ys, xs = (np.mgrid[:height, :width] + 0.5) / px_per_mm
    for loop in board.outlines():
        inside = np.zeros_like(out)
        for (x0, y0), (x1, y1) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            if y0 != y1:
                inside ^= (np.minimum(y0, y1) <= ys) & (ys < np.maximum(y0, y1)) & (xs < x0)
                assert x0 == x1, "every edge is level or upright"
        out ^= inside
    return np.where(out, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("size", [(5, 7), (5, 4), (4, 5), (6, 4)])
@pytest.mark.parametrize("name", ["5x5_100", "apriltag_36h11"])
def test_charuco_is_opencvs(size: tuple[int, int], legacy: bool, name: str) -> None:
    cells = family(name, Path()).cells
    board = charuco(*size, legacy=legacy, family=name, square_mm=2.0 * cells, marker_mm=1.0 * cells, first_id=3)
    theirs = cv2.aruco.CharucoBoard(size, 2.0 * cells, 1.0 * cells, family(name, Path()).dictionary, _ids(board))
    theirs.setLegacyPattern(legacy)
    drawn = theirs.generateImage(tuple(round(value * 2) for value in board.size_mm), marginSize=0)
    assert np.array_equal(painted(board, 2), drawn)
    assert np.allclose(board.points().mm, theirs.getChessboardCorners())
    assert board.points().ids.tolist() == list(range((size[0] - 1) * (size[1] - 1)))
    own = family(name, Path()).own_order
    for marker, corners in zip(board.markers, theirs.getObjPoints(), strict=True):
        assert np.allclose(marker.corners, np.asarray(corners)[list(own), :2])


@pytest.mark.parametrize("name", ["4x4_50", "apriltag_25h9"])
def test_aruco_grid_is_opencvs(name: str) -> None:
    cells = family(name, Path()).cells
    board = grid(family=name, marker_mm=2.0 * cells, gap_mm=5.0, first_id=2)
    theirs = cv2.aruco.GridBoard((4, 3), 2.0 * cells, 5.0, family(name, Path()).dictionary, _ids(board))
    drawn = theirs.generateImage(tuple(round(value * 2) for value in board.size_mm), marginSize=0)
    assert np.array_equal(painted(board, 2), drawn)
    own = family(name, Path()).own_order
    corners = np.asarray(theirs.getObjPoints())[:, list(own)].reshape(-1, 3)
    assert np.allclose(board.points().mm, corners)
    assert board.points().ids.tolist() == [4 * marker + corner for marker in range(2, 14) for corner in range(4)]


def test_aprilgrid_is_kalibrs() -> None:
    """Ids from the bottom left, black squares at all corners of the tags, tags upright in AprilTag's own frame."""
    board = grid("aprilgrid", family="apriltag_36h11", marker_mm=32.0, gap_mm=8.0)
    assert board.size_mm == (4 * 32 + 5 * 8, 3 * 32 + 4 * 8)
    first, last = board.markers[0], board.markers[-1]
    assert first.corners.tolist() == [[8, 88], [40, 88], [40, 120], [8, 120]]
    assert last.corners[0].tolist() == [128, 8]
    picture = painted(board, 1)
    assert (picture[0:8, 0:8] == 0).all()
    assert (picture[80:88, 120:128] == 0).all()
    assert (picture[0:8, 8:40] == 255).all()
    cells = picture[90:120:4, 10:40:4] // 255
    assert cells.tolist() == family("apriltag_36h11", Path()).bitmap(0).tolist()
    wide = painted(grid("aprilgrid", family="apriltag_36h11", marker_mm=40.0, gap_mm=8.0, border_bits=2), 1)
    assert (wide[-48:-40, 8:48] == 0).all()
    assert (wide[-44:-12:4, 12:44:4] // 255).tolist() == cells.tolist()


def test_a_chessboard_begins_black_and_counts_inner_corners() -> None:
    board = chessboard()
    assert board.size_mm == (250, 175)
    picture = painted(board, 1)
    assert (picture[:25, :25] == 0).all()
    assert (picture[:25, 25:50] == 255).all()
    points = board.points()
    assert points.mm[0].tolist() == [25, 25, 0]
    assert points.mm[9].tolist() == [25, 50, 0]
    assert len(points.ids) == 54
    framed = cv2.copyMakeBorder(painted(board, 2), 50, 50, 50, 50, cv2.BORDER_CONSTANT, value=255)
    found, corners = cv2.findChessboardCornersSB(framed, (9, 6))
    assert found
    assert np.allclose(np.sort(corners.reshape(-1, 2), axis=0), np.sort(points.mm[:, :2] * 2 + 49.5, axis=0), atol=0.1)


@pytest.mark.parametrize(("size", "ambiguous"), [((9, 6), False), ((8, 6), True), ((7, 7), True), ((4, 6), True)])
def test_a_chessboard_of_like_parity_is_ambiguous(size: tuple[int, int], ambiguous: bool) -> None:
    board = chessboard(*size)
    picture = painted(board, 1)
    assert np.array_equal(picture, picture[::-1, ::-1]) == ambiguous
    assert board.ambiguous == ambiguous


def test_the_measured_scale_is_in_all_that_is_measured() -> None:
    board, printed = charuco(), charuco(measured_scale=0.98)
    assert np.allclose(printed.points().mm, board.points().mm * 0.98)
    assert np.allclose(printed.size_mm, np.array(board.size_mm) * 0.98)
    for a, b in zip(printed.outlines(), board.outlines(), strict=True):
        assert np.allclose(a, b * 0.98)
    assert np.allclose(printed.markers[5].corners, board.markers[5].corners * 0.98)
    assert printed.as_drawn() == board


def test_outlines_give_the_pattern_again() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        black = rng.random((rng.integers(1, 9), rng.integers(1, 9))) < rng.random()
        again = np.zeros_like(black)
        ys, xs = np.mgrid[: black.shape[0], : black.shape[1]] + 0.5
        for loop in outlines(black):
            for (x0, y0), (_, y1) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                again ^= (min(y0, y1) < ys) & (ys < max(y0, y1)) & (xs < x0)
        assert np.array_equal(again, black)


@pytest.mark.parametrize(
    "board",
    [chessboard(), charuco(legacy=True), grid(), grid("aprilgrid", border_bits=2, first_id=7, measured_scale=0.987)],
    ids=lambda board: board.kind,
)
def test_a_description_comes_back(board: Board, tmp_path: Path) -> None:
    write_board(tmp_path / "board.yaml", board)
    assert read_board(tmp_path / "board.yaml") == board


MISTAKES = {
    "kind: chesboard\ncolumns: 9\nrows: 6\nsquare_mm: 25\n": "1: kind: 'chesboard' is not allowed; did you mean",
    "kind: chessboard\ncolumns: 9\nrows: 6\n": "a chessboard board needs square_mm",
    "kind: chessboard\ncolumns: 2\nrows: 6\nsquare_mm: 25\n": "2 x 6 is too small",
    "kind: chessboard\ncolumns: 9\nrows: 6\nsquare_mm: 25\nmarker_mm: 3\n": "has no marker_mm",
    "kind: charuco\ncolumns: 9\nrows: 6\nsquare_mm: 25\nmarker_mm: 25\nfamily: 4x4_50\n": "must be smaller than",
    "kind: charuco\ncolumns: 9\nrows: 6\nsquare_mm: 25\nmarker_mm: 20\n": "family is missing",
    "kind: charuco\ncolumns: 20\nrows: 6\nsquare_mm: 25\nmarker_mm: 20\nfamily: 4x4_50\n": "needs the ids 0 to 59",
    "kind: charuco\ncolumns: 2\nrows: 6\nsquare_mm: 25\nmarker_mm: 20\nfamily: 4x4_5\n": "no marker family '4x4_5'",
    "kind: aruco-grid\ncolumns: 2\nrows: 6\nmarker_mm: 25 mm\ngap_mm: 20\nfamily: 4x4_50\n": "write 25 without",
    "kind: aruco-grid\ncolums: 2\nrows: 6\nmarker_mm: 25\ngap_mm: 20\nfamily: 4x4_50\n": "did you mean 'columns'",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_told_with_its_place(text: str, tmp_path: Path) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_board(path)
    assert MISTAKES[text] in caught.value.message
    assert str(path) in caught.value.message


def test_a_dictionary_file_lies_beside_the_description_wherever_it_is_read_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, here = tmp_path / "boards", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    storage = cv2.FileStorage(str(there / "own.yml"), cv2.FILE_STORAGE_WRITE)
    cv2.aruco.extendDictionary(40, 5).writeDictionary(storage)
    storage.release()
    monkeypatch.chdir(there)
    ids = [marker.id for marker in charuco(family="own.yml").markers]
    monkeypatch.chdir(here)
    (there / "by-hand.yaml").write_text(
        "kind: charuco\ncolumns: 5\nrows: 7\nsquare_mm: 30\nmarker_mm: 20\nfamily: own.yml\n"
    )
    found = read_board(there / "by-hand.yaml")
    assert found.family == str(there / "own.yml")
    assert [marker.id for marker in found.markers] == ids
    write_board(here / "copied.yaml", found)
    assert "family: ../boards/own.yml" in (here / "copied.yaml").read_text()
    assert [marker.id for marker in read_board(here / "copied.yaml").markers] == ids


def test_a_board_that_cannot_be_is_no_board() -> None:
    with pytest.raises(ValidationError, match="legacy is a layout of charuco"):
        chessboard(legacy=True)


def _ids(board: Board) -> NDArray[np.int32]:
    return np.array([marker.id for marker in board.markers], dtype=np.int32)
