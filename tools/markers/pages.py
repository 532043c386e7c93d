"""The printed sheet: markers with their cut lines and labels, imposed on pages with a ruler each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.boards.outlines import outlines
from common.errors import RefusedError
from tools.markers.canvas import BLACK, FAINT, INK, MUTED, Canvas, wrapped
from tools.markers.impose import Block, Placed, impose
from tools.markers.label import RigMarker, arrow, label_lines, title, up_direction
from tools.markers.paper import UNPRINTABLE_BELOW_MM, Paper, larger_than
from tools.markers.ruler import CALIPER_MM, LENGTH_MM, SMALL_CALIPER_MM, draw_caliper_box, draw_ruler

Array = NDArray[np.float64]

MARGIN = 10.0
HEAD = 17.0
FOOT = 21.0
GAP = 8.0
"""Between two markers; their cut lines reach 2.5 mm beyond them."""
_OVERSHOOT = 2.5
_LABEL = 58.0
_LABEL_GAP = 3.6
_ARROW = 8.0
_ARROW_COLUMN = 8.0
_TITLE, _WORDS = 9.0, 6.5
_TITLE_STEP, _WORDS_STEP = 4.2, 3.05
_NOTE = 1.9
"""Depth of the border's outermost rim that carries id and up, if a whole cell around the black square stays white:
cut out, all markers look the same."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A marker as it is printed. ``beside``: the label stands to its right, else below."""

    one: RigMarker
    title: tuple[str, ...]
    lines: tuple[str, ...]
    beside: bool

    @property
    def label_height(self) -> float:
        """Of the label, mm."""
        return max(len(self.title) * _TITLE_STEP + len(self.lines) * _WORDS_STEP, _ARROW + 3)


@dataclass(frozen=True)
class Sheet:
    """All markers with their places: top left corners of their *cells* on the paper, mm."""

    paper: Paper
    cells: tuple[Placed[Cell], ...]

    @property
    def pages(self) -> int:
        """How many."""
        return self.cells[-1].page + 1 if self.cells else 0

    def square(self, placed: Placed[Cell]) -> Array:
        """The black square's corners (4, 2) TL TR BR BL on its page, mm from the paper's top left corner."""
        marker = placed.block.item.one.marker
        corner = np.array([placed.x, placed.y]) + marker.border_mm
        return corner + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * marker.size_mm


def lay_out(markers: Sequence[RigMarker], paper: Paper) -> Sheet:
    """Place the markers. Raises RefusedError for one that the paper can't hold, with one that can."""
    width, height = _area(paper)
    blocks = [_block(one) for one in markers]
    for block in blocks:
        if block.width > width or block.height > height:
            _refuse(block, paper)
    placed = impose(blocks, width, height, GAP)
    top = MARGIN + HEAD
    return Sheet(paper, tuple(Placed(one.block, one.page, one.x + MARGIN, one.y + top) for one in placed))


def _area(paper: Paper) -> tuple[float, float]:
    """What a page has for markers: width and height, mm."""
    return paper.width - 2 * MARGIN, paper.height - MARGIN - HEAD - FOOT - UNPRINTABLE_BELOW_MM


def _refuse(block: Block[Cell], paper: Paper) -> None:
    one = block.item.one
    holds = [other.name for other in larger_than(paper) if _fits(block, other)]
    cure = f"--paper {holds[0]} would hold it" if holds else "no paper up to A0 would; choose a smaller marker"
    raise RefusedError(
        f"{one.object}, side {one.side.class_name}: marker {one.marker.id} is {one.edge_mm:g} mm wide with its border "
        f"and does not fit {paper.name} ({paper.width:g} x {paper.height:g} mm) with its label and the ruler; {cure}",
        code="paper_too_small",
    )


def _fits(block: Block[Cell], paper: Paper) -> bool:
    width, height = _area(paper)
    return block.width <= width and block.height <= height


def _block(one: RigMarker) -> Block[Cell]:
    """The marker with its label where both take less of the paper."""
    edge = one.edge_mm
    below, beside = _cell(one, max(edge, _LABEL), beside=False), _cell(one, _LABEL, beside=True)
    candidates = (
        Block(below, max(edge, _LABEL), edge + _LABEL_GAP + below.label_height),
        Block(beside, edge + _LABEL_GAP + _LABEL, max(edge, beside.label_height)),
    )
    return min(candidates, key=lambda block: block.width * block.height)


def _cell(one: RigMarker, width: float, *, beside: bool) -> Cell:
    room = width - _ARROW_COLUMN
    heading = wrapped(title(one), _TITLE, room, bold=True)
    lines = [part for line in label_lines(one) for part in wrapped(line, _WORDS, room)]
    return Cell(one, tuple(heading), tuple(lines), beside)


# --- drawing


def draw(sheet: Sheet, rig: Path) -> bytes:
    """The sheet as PDF."""
    canvas = Canvas(sheet.paper, f"Markers of {rig.name}")
    for page in range(sheet.pages):
        if page:
            canvas.next_page()
        _frame(canvas, rig, f"page {page + 1} of {sheet.pages}")
        for placed in sheet.cells:
            if placed.page == page:
                _marker(canvas, sheet, placed)
    return canvas.finish()


def _frame(canvas: Canvas, rig: Path, page: str) -> None:
    """Head and foot of a page."""
    paper = canvas.paper
    right = paper.width - MARGIN
    canvas.text((MARGIN, MARGIN + 4), f"Markers of {rig.name}", 12, bold=True)
    canvas.text((right, MARGIN + 4), f"tagmill · {paper.name} · {page}", 7.5, grey=MUTED, align="right")
    canvas.text((MARGIN, MARGIN + 9), "Print at 100 % (“actual size”), not “fit to page”. Cut along the lines.", 7.5)
    canvas.line((MARGIN, MARGIN + 11.5), (right, MARGIN + 11.5), width=0.2, grey=FAINT)
    top = paper.height - UNPRINTABLE_BELOW_MM - FOOT + 5
    canvas.line((MARGIN, top - 3.5), (right, top - 3.5), width=0.2, grey=FAINT)
    draw_ruler(canvas, MARGIN + 2, top)
    roomy = paper.width - 2 * MARGIN >= LENGTH_MM + 12 + CALIPER_MM[0]
    box = CALIPER_MM if roomy else SMALL_CALIPER_MM
    draw_caliper_box(canvas, right - box[0], top, box)
    advice = f"Does the ruler not measure 100 mm? tagmill markers sheet {rig.name} --measured WHAT-IT-MEASURES"
    room = paper.width - 2 * MARGIN - box[0] - 4
    for number, line in enumerate(wrapped(advice, 6, room)):
        canvas.text((MARGIN + 2, top + 12.2 + 2.6 * number), line, 6, grey=MUTED)


def _marker(canvas: Canvas, sheet: Sheet, placed: Placed[Cell]) -> None:
    cell = placed.block.item
    one = cell.one
    edge = one.edge_mm
    x, y = placed.x, placed.y
    for step in (0, edge):
        canvas.line((x - _OVERSHOOT, y + step), (x + edge + _OVERSHOOT, y + step), width=0.1, grey=FAINT)
        canvas.line((x + step, y - _OVERSHOOT), (x + step, y + edge + _OVERSHOOT), width=0.1, grey=FAINT)
    black = one.family.bitmap(one.marker.id) == 0
    canvas.fill([loop * one.cell_mm + sheet.square(placed)[0] for loop in outlines(black)], BLACK)
    if one.marker.border_mm >= one.cell_mm + _NOTE - 0.05:
        _note_in_border(canvas, one, np.array([x, y]))
    _label(canvas, cell, x + edge + _LABEL_GAP if cell.beside else x, y if cell.beside else y + edge + _LABEL_GAP)


def _note_in_border(canvas: Canvas, one: RigMarker, corner: Array) -> None:
    """Id and up, pale and small, where they stay on the marker after it was cut out."""
    edge, rotation = one.edge_mm, one.marker.rotation_deg
    up = up_direction(rotation)
    tip = corner + edge / 2 + up * ((edge / 2 - 0.4) / np.abs(up).max())
    across = np.array([-up[1], up[0]])
    canvas.fill([np.array([tip, tip - up * 1.4 + across * 0.5, tip - up * 1.4 - across * 0.5])], FAINT)
    canvas.text((corner[0] + 0.7, corner[1] + edge - 0.7), f"{one.marker.id}", 4.5, grey=FAINT)


def _label(canvas: Canvas, cell: Cell, x: float, y: float) -> None:
    canvas.fill(
        [arrow(np.array([x + _ARROW_COLUMN / 2 - 1, y + _ARROW / 2]), cell.one.marker.rotation_deg, _ARROW)], INK
    )
    canvas.text((x + _ARROW_COLUMN / 2 - 1, y + _ARROW + 2.4), "up", 6.5, grey=MUTED, align="centre")
    base = y - 1.1
    for line in cell.title:
        base += _TITLE_STEP
        canvas.text((x + _ARROW_COLUMN, base), line, _TITLE, bold=True)
    for line in cell.lines:
        base += _WORDS_STEP
        canvas.text((x + _ARROW_COLUMN, base), line, _WORDS, grey=MUTED)
