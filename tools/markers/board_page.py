"""A calibration board on its page: the pattern, and below it a strip with the ruler and what the board is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.boards import Board
from common.errors import RefusedError
from tools.markers.canvas import INK, MUTED, Canvas, wrapped
from tools.markers.paper import Paper, larger_than
from tools.markers.ruler import LENGTH_MM, draw_ruler

MARGIN = 8.0
"""Less than a sheet of markers has: a board wants to be large, and white is all that is lost at its rim."""
_GAP = 3.0
_STRIP = 12.0
_RULER = LENGTH_MM + 12.0
_ROOM = 60.0
"""What words beside the ruler need; on narrower paper they stand below it."""
_STRIP_WITH_WORDS = 21.0
_POINTS, _STEP = 6.5, 3.0


@dataclass(frozen=True, slots=True)
class BoardPage:
    """A board on paper that lies as it must; ``x``, ``y``: the pattern's top left corner, mm."""

    board: Board
    paper: Paper
    x: float
    y: float


def fits(board: Board, paper: Paper) -> bool:
    """Whether the paper holds it, upright or lying."""
    return _oriented(board, paper) is not None


def fitted(board: Board, paper: Paper) -> BoardPage:
    """The board's page. Raises RefusedError with a paper that would hold it."""
    chosen = _oriented(board, paper)
    if chosen is None:
        holds = [other.name for other in larger_than(paper) if fits(board, other)]
        width, height = board.size_mm
        cure = f"--paper {holds[0]} would hold it" if holds else "no paper up to A0 would"
        raise RefusedError(
            f"the board is {width:g} x {height:g} mm and does not fit {paper.name} ({paper.width:g} x "
            f"{paper.height:g} mm) with its ruler; {cure}; without sizes the largest that fits is made",
            code="paper_too_small",
        )
    width, height = board.size_mm
    free = chosen.height - 2 * MARGIN - _GAP - _strip(chosen) - height
    return BoardPage(board, chosen, (chosen.width - width) / 2, MARGIN + free / 2)


def _oriented(board: Board, paper: Paper) -> Paper | None:
    width, height = board.size_mm
    for candidate in (paper.upright, paper.lying):
        high = candidate.height - 2 * MARGIN - _GAP - _strip(candidate)
        if width <= candidate.width - 2 * MARGIN + 1e-6 and height <= high + 1e-6:
            return candidate
    return None


def _strip(paper: Paper) -> float:
    return _STRIP if paper.width - 2 * MARGIN - _RULER >= _ROOM else _STRIP_WITH_WORDS


def describe(board: Board) -> str:
    """The board in one line."""
    count = f"{board.kind} {board.columns} × {board.rows}"
    sizes = {"squares": board.square_mm, "markers": board.marker_mm, "gaps": board.gap_mm}
    parts = [f"{what} {size:g} mm" for what, size in sizes.items() if size is not None]
    if board.kind == "chessboard":
        return f"{count} inner corners, {', '.join(parts)}"
    ids = f"{board.family} ids {board.markers[0].id} to {board.markers[-1].id}"
    more = [*(["legacy layout"] if board.legacy else []), *(["2 border bits"] if board.border_bits == 2 else [])]
    return f"{count}, {', '.join([*parts, ids, *more])}"


def draw(page: BoardPage, description: str) -> bytes:
    """The page as PDF; ``description``: the name of the board's YAML file."""
    canvas = Canvas(page.paper, describe(page.board))
    corner = np.array([page.x, page.y])
    canvas.fill([loop + corner for loop in page.board.outlines()])
    paper = page.paper
    top = paper.height - MARGIN - _strip(paper)
    draw_ruler(canvas, MARGIN + 2, top)
    beside = _strip(paper) == _STRIP
    x, y = (MARGIN + _RULER, top + 2.6) if beside else (MARGIN + 2, top + 12)
    room = paper.width - MARGIN - x
    advice = "Print at 100 %, glue it on something flat, measure the ruler: "
    advice += f"tagmill markers board {description} --measured WHAT-IT-MEASURES"
    lines = [(line, INK) for line in wrapped(describe(page.board), _POINTS, room)]
    lines += [(line, MUTED) for line in wrapped(advice, _POINTS, room)]
    for number, (line, grey) in enumerate(lines):
        canvas.text((x, y + number * _STEP), line, _POINTS, grey=grey)
    return canvas.finish()
