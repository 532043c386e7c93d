"""Sizes for boards whose sizes were left open: the usual proportions, as large as the paper allows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from common.boards import Board, BoardKind
from common.errors import RefusedError
from tools.calibrate.board_options import validated
from tools.markers.board_page import fits
from tools.markers.paper import Paper


class Default(NamedTuple):
    """A board that suits A4 or Letter. ``other``: the dependent size as a share of the leading one."""

    size: str
    family: str | None
    other: tuple[str, float] | None


DEFAULTS: dict[BoardKind, Default] = {
    "chessboard": Default("9x6", None, None),
    "charuco": Default("11x8", "5x5_100", ("marker_mm", 0.75)),
    "aprilgrid": Default("6x4", "apriltag_36h11", ("gap_mm", 0.3)),
    "aruco-grid": Default("7x5", "4x4_50", ("gap_mm", 0.25)),
}
_STEP_MM = 0.5


def unit_of(kind: BoardKind) -> str:
    """The size from which the others follow."""
    return "square_mm" if kind in ("chessboard", "charuco") else "marker_mm"


def with_proportions(given: Mapping[str, Any]) -> dict[str, Any]:
    """With the dependent size, where it was left open, rounded to 0.1 mm."""
    other = DEFAULTS[given["kind"]].other
    if other is None or other[0] in given:
        return dict(given)
    return {**given, other[0]: round(other[1] * given[unit_of(given["kind"])], 1)}


def largest(given: Mapping[str, Any], paper: Paper) -> Board:
    """The board with the largest unit, in half millimetres, that the paper holds. Raises ConfigError, RefusedError."""
    unit = unit_of(given["kind"])
    steps = int(max(paper.width, paper.height) / _STEP_MM)
    # A size that the dependent one forbids (a ChArUco marker larger than its square) is told by the validator.
    least = float(given.get("marker_mm", 0)) if given["kind"] == "charuco" else 0.0
    first = max(1, int(least / _STEP_MM) + 1)
    best = None
    for step in range(first, max(first, steps) + 1):
        board = validated(with_proportions({**given, unit: step * _STEP_MM}))
        if not fits(board, paper):
            break
        best = board
    if best is None:
        raise RefusedError(
            f"{paper.name} can't hold a board ({given['kind']}) of {given['columns']} x {given['rows']} with these "
            "sizes; choose fewer, smaller ones, or a larger paper",
            code="paper_too_small",
        )
    return best
