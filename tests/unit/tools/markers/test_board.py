"""`tagmill markers board`: rendered by another program, found by OpenCV, compared with the description beside it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from common.boards import Board, read_board
from common.errors import EXIT_OK, EXIT_REFUSED
from tests.support.printed import need_poppler, rendered, to_mm
from tools.cli import main
from tools.markers.board_page import fitted
from tools.markers.paper import parse_paper


def found_points(board: Board, page: NDArray[np.uint8], dpi: int) -> dict[int, NDArray[np.float64]]:
    """What OpenCV finds of the board, mm on the page, by the ids of ``Board.points``."""
    if board.kind == "chessboard":
        found, corners = cv2.findChessboardCornersSB(page, (board.columns, board.rows))
        assert found
        points = to_mm(corners.reshape(-1, 2).astype(float), dpi)
        # It may begin at either end of a row or column.
        grid = points.reshape(board.rows, board.columns, 2)
        grid = grid[:: 1 if grid[0, 0, 1] < grid[-1, 0, 1] else -1, :: 1 if grid[0, 0, 0] < grid[0, -1, 0] else -1]
        return dict(enumerate(grid.reshape(-1, 2)))
    markers = board.marker_family
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.markerBorderBits = board.border_bits
    if board.kind == "charuco":
        assert board.square_mm is not None
        assert board.marker_mm is not None
        ids = np.array([marker.id for marker in board.markers])
        size = (board.columns, board.rows)
        theirs = cv2.aruco.CharucoBoard(size, board.square_mm, board.marker_mm, markers.dictionary, ids)
        theirs.setLegacyPattern(board.legacy)
        detector = cv2.aruco.CharucoDetector(theirs)
        detector.setDetectorParameters(parameters)
        corners, numbers, _, _ = detector.detectBoard(page)
        assert corners is not None
        flat = to_mm(np.asarray(corners).reshape(-1, 2).astype(float), dpi)
        return dict(zip((int(number) for number in np.asarray(numbers).ravel()), flat, strict=True))
    quads, numbers, _ = cv2.aruco.ArucoDetector(markers.dictionary, parameters).detectMarkers(page)
    assert numbers is not None
    out = {}
    for number, quad in zip(numbers.ravel(), quads, strict=True):
        own = to_mm(quad.reshape(4, 2)[list(markers.own_order)].astype(float), dpi)
        out.update({4 * int(number) + corner: own[corner] for corner in range(4)})
    return out


@pytest.mark.parametrize(
    ("options", "paper"),
    [
        (["chessboard"], "A4"),
        (["chessboard", "--size", "4x7", "--square-mm", "25"], "Letter"),
        (["charuco"], "Letter"),
        (["charuco", "--size", "5x8", "--legacy", "--first-id", "7"], "A4"),
        (["charuco", "--family", "apriltag_36h11", "--size", "6x5"], "A3"),
        (["aprilgrid"], "A3"),
        (["aprilgrid", "--border-bits", "2"], "A4"),
        (["aruco-grid"], "A4"),
        (["aruco-grid", "--family", "tag36h11", "--size", "5x4"], "200x260"),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(value),
)
def test_a_board_is_printed_as_it_is_described(options: list[str], paper: str, tmp_path: Path) -> None:
    need_poppler()
    out = tmp_path / "board.pdf"
    assert main(["markers", "board", *options, "--paper", paper, "--out", str(out)]) == EXIT_OK
    board = read_board(tmp_path / "board.yaml")
    page = fitted(board, parse_paper(paper))
    dpi = 150 if board.kind == "chessboard" else 300  # that search is slow in large pictures, and exact in small ones
    (picture,) = rendered(out, dpi)
    found = found_points(board, picture, dpi)
    points = board.points()
    assert sorted(found) == points.ids.tolist()
    expected = points.mm[:, :2] + (page.x, page.y)
    errors = np.array([found[int(number)] for number in points.ids]) - expected
    assert np.abs(errors).max() <= 0.1
    assert "/Image" not in out.read_bytes().decode("latin-1").replace("/ImageC", "").replace("/ImageB", "").replace(
        "/ImageI", ""
    )


@pytest.mark.parametrize("kind", ["chessboard", "charuco", "aprilgrid", "aruco-grid"])
def test_without_sizes_it_is_the_largest_that_fits(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "b.pdf"
    assert main(["markers", "board", kind, "--out", str(out), "--json"]) == EXIT_OK
    board = json.loads(capsys.readouterr().out)["board"]
    unit = "square_mm" if "square_mm" in board else "marker_mm"
    larger = [f"--{unit.replace('_', '-')}", str(board[unit] + 1)]
    assert main(["markers", "board", kind, *larger, "--out", str(tmp_path / "c.pdf")]) == EXIT_REFUSED
    assert "--paper A3 would hold it" in capsys.readouterr().err
    assert not (tmp_path / "c.pdf").exists()
    assert not (tmp_path / "c.yaml").exists()


def test_the_measured_ruler_goes_into_the_description(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, description = tmp_path / "b.pdf", tmp_path / "b.yaml"
    assert main(["markers", "board", "charuco", "--out", str(out)]) == EXIT_OK
    before, printed = read_board(description), out.read_bytes()
    assert main(["markers", "board", str(description), "--measured", "98.7"]) == EXIT_OK
    assert "measured_scale: 0.987" in capsys.readouterr().out
    assert read_board(description) == before.with_scale(0.987)
    again = tmp_path / "again.pdf"
    assert main(["markers", "board", str(description), "--out", str(again)]) == EXIT_OK
    assert read_board(tmp_path / "again.yaml").measured_scale == 0.987, "the same printer is thought to print it"
    assert len(again.read_bytes()) == pytest.approx(len(printed), abs=200), "drawn at its nominal sizes"


def test_a_board_that_looks_the_same_upside_down_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "b.pdf")
    assert main(["markers", "board", "chessboard", "--size", "8x6", "--out", out]) == EXIT_OK
    assert "look the same upside down" in capsys.readouterr().out
    assert main(["markers", "board", "chessboard", "--size", "9x6", "--out", out]) == EXIT_OK
    assert "warning" not in capsys.readouterr().out


def test_the_bare_board_as_picture(tmp_path: Path) -> None:
    out = tmp_path / "b.pdf"
    assert main(["markers", "board", "charuco", "--size", "5x4", "--png", "--svg", "--out", str(out)]) == EXIT_OK
    board = read_board(tmp_path / "b.yaml")
    picture = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    margin = 0.1 * min(board.size_mm)
    assert np.allclose(np.array(picture.shape[::-1]) / 600 * 25.4, np.array(board.size_mm) + 2 * margin, atol=0.05)
    small = np.ascontiguousarray(picture[::4, ::4])
    _, ids, _ = cv2.aruco.ArucoDetector(board.marker_family.dictionary).detectMarkers(small)
    assert sorted(np.asarray(ids).ravel().tolist()) == list(range(10))
    assert "<svg" in (tmp_path / "b.svg").read_text()


MISTAKES: dict[tuple[str, ...], str] = {
    ("charuco", "--out", "board.yaml"): "must end in .pdf",
    ("chesboard",): "is no kind of board and no file",
    ("nothing.yaml",): "there is no such file",
    ("charuco", "--measured", "99"): "name its description",
    ("charuco", "--size", "9"): "--size must be columns x rows",
    ("charuco", "--family", "4x4_5"): "there is no marker family",
    ("charuco", "--size", "20x20", "--family", "4x4_50"): "needs the ids 0 to 199",
    ("charuco", "--square-mm", "10", "--marker-mm", "12"): "must be smaller than square_mm",
    ("charuco", "--marker-mm", "90"): "A4 can't hold a board (charuco) of 11 x 8",
    ("chessboard", "--marker-mm", "5"): "has no marker_mm",
    ("aruco-grid", "--gap-mm", "400"): "A4 can't hold a board (aruco",
}


@pytest.mark.parametrize("words", MISTAKES, ids=" ".join)
def test_a_mistake_is_one_sentence_and_leaves_nothing(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["markers", "board", *words]) == EXIT_REFUSED
    said = capsys.readouterr().err
    assert MISTAKES[words] in said, said
    assert list(tmp_path.iterdir()) == []
