"""What the guide says, in the terminal: one sentence, a map of the picture, the tilts, the verdict."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from common.calibration import Guidance, tilt_counts
from common.calibration.diversity import GRID
from common.calibration.verdict import GOOD_VIEWS
from common.calibration.wishes import WANTED_PER_TILT

Array = NDArray[np.float64]
_STYLES = {"taken": "bold green", "refused": "yellow", "holding": "bold cyan", "done": "bold green"}
_LEGEND = "# covered   . bare   [ ] where to hold the board   o where it is"
_BAR = 20


class GuidedView:
    """Shows guidance: live on a terminal, else a line for each view taken or refused; nothing if ``quiet``."""

    def __init__(self, title: str, *, quiet: bool) -> None:
        self._title = title
        self._console = Console(stderr=True)
        self._quiet = quiet
        self._last = ""
        self._live: Live | None = None
        if not quiet and self._console.is_terminal:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)

    def show(self, told: Guidance) -> None:
        """What the guide said last."""
        if self._quiet:
            return
        if self._live is not None:
            self._live.update(screen(told, self._title), refresh=True)
        elif told.phase in ("taken", "refused", "done") and told.words != self._last:
            self._last = told.words
            self._console.print(told.words, markup=False, highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
            self._live.update(Text(f"{self._title}: waiting for a picture"), refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()


def screen(told: Guidance, title: str) -> RenderableType:
    """All of it for one frame."""
    words = told.words[:1].upper() + told.words[1:]
    sentence = Text(words, style=_STYLES.get(told.phase, "bold"))
    held = round(told.held * _BAR)
    hold = Text(f"still {'=' * held}{' ' * (_BAR - held)}|", style="cyan" if held else "dim")
    table = Table(box=None, show_header=False, padding=(0, 3, 0, 0))
    table.add_row(Group(*(Text(line) for line in picture_map(told)), Text(_LEGEND, style="dim")), _lacks(told))
    parts: list[RenderableType] = [sentence, hold, table]
    if told.verdict is not None:
        parts.append(Text(f"{told.verdict.level}: {told.verdict.sentence}"))
    return Panel(
        Group(*parts),
        title=f"{title}: {told.count} view{'' if told.count == 1 else 's'}",
        subtitle="Ctrl-C ends, and keeps what was taken",
    )


def picture_map(told: Guidance) -> list[str]:
    """The picture's cells, three characters each: what is covered, where the board is and where it should be."""
    (columns, rows), size = GRID, told.size
    cells = np.zeros((rows, columns)) if told.spread is None else told.spread.cells
    lines = []
    for row in range(rows):
        line = ""
        for column in range(columns):
            at = ((column + 0.5) / columns * size[0], (row + 0.5) / rows * size[1])
            mark = "o" if _inside(told.outline, at) else "#" if cells[row, column] else "."
            line += f"[{mark}]" if _inside(told.ghost, at) else f" {mark} "
        lines.append(line)
    return lines


def _inside(polygon: Array | None, at: tuple[float, float]) -> bool:
    if polygon is None or not np.isfinite(polygon).all():
        return False
    return cv2.pointPolygonTest(polygon.astype(np.float32), at, measureDist=False) >= 0


def _lacks(told: Guidance) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 1, 0, 0))
    table.add_row("views", _enough(told.count, GOOD_VIEWS))
    if told.spread is not None:
        table.add_row("covered", Text(f"{told.spread.covered:.0%}"))
        for way, count in tilt_counts(told.spread).items():
            name = way if way == "straight" else f"tilted, looks to the {way}"
            table.add_row(name, _enough(count, WANTED_PER_TILT))
    return table


def _enough(count: int, wanted: int) -> Text:
    return Text(f"{count} of {wanted}", style="green" if count >= wanted else "yellow")
