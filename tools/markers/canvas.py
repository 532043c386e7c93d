"""A vector page in millimetres, x right and y down from its top left corner, written as PDF by reportlab.

Fonts are embedded, so that every viewer and printer shows the same text.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from reportlab.lib.colors import Color
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.pdfgen.canvas import Canvas as Pdf

from tools.markers.paper import Paper

Array = NDArray[np.float64]
POINTS_PER_MM = 72 / 25.4
_FILL_EVEN_ODD = 0
"""reportlab's own constant, which its type stubs lack."""
REGULAR, BOLD = "Vera", "VeraBd"
BLACK, INK, MUTED, FAINT = 0.0, 0.12, 0.35, 0.62
"""Grey levels: of markers, of words that matter, of other words, of cut lines."""


class Canvas:
    """Pages of one PDF. Lengths in mm, text sizes in points, greys 0 (black) to 1."""

    def __init__(self, paper: Paper, title: str) -> None:
        _register_fonts()
        self.paper = paper
        self._written = io.BytesIO()
        size = (paper.width * POINTS_PER_MM, paper.height * POINTS_PER_MM)
        # invariant: the same markers give the same file, byte by byte.
        self._pdf = Pdf(self._written, pagesize=size, invariant=1, pageCompression=1, initialFontName=REGULAR)  # type: ignore[arg-type]
        self._pdf.setTitle(title)
        self._pdf.setCreator("tagmill")
        # Asks the viewer's print dialogue for 100 % instead of "fit to page".
        self._pdf.setViewerPreference("PrintScaling", "None")

    def next_page(self) -> None:
        """End this page and begin the next."""
        self._pdf.showPage()

    def finish(self) -> bytes:
        """The PDF; nothing can be drawn afterwards."""
        self._pdf.save()
        return self._written.getvalue()

    def fill(self, loops: Iterable[Array], grey: float = BLACK) -> None:
        """Fill closed loops (n, 2) together by the even-odd rule."""
        path = self._pdf.beginPath()
        for loop in loops:
            path.moveTo(*self._at(*loop[0]))
            for x, y in loop[1:]:
                path.lineTo(*self._at(x, y))
            path.close()
        self._pdf.setFillColor(_grey(grey))
        self._pdf.drawPath(path, stroke=0, fill=1, fillMode=_FILL_EVEN_ODD)

    def line(self, start: Sequence[float], end: Sequence[float], *, width: float = 0.15, grey: float = BLACK) -> None:
        """A straight line of ``width`` mm with flat ends."""
        self._pdf.setStrokeColor(_grey(grey))
        self._pdf.setLineWidth(width * POINTS_PER_MM)
        self._pdf.line(*self._at(*start), *self._at(*end))

    def text(
        self,
        at: Sequence[float],
        words: str,
        points: float,
        *,
        bold: bool = False,
        grey: float = INK,
        align: Literal["left", "centre", "right"] = "left",
    ) -> None:
        """One line of text whose baseline is at ``at``."""
        font = BOLD if bold else REGULAR
        x, y = self._at(*at)
        width = pdfmetrics.stringWidth(words, font, points)
        self._pdf.setFont(font, points)
        self._pdf.setFillColor(_grey(grey))
        self._pdf.drawString(x - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width, y, words)

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return float(x) * POINTS_PER_MM, (self.paper.height - float(y)) * POINTS_PER_MM


def text_width(words: str, points: float, *, bold: bool = False) -> float:
    """How long a line of text is, mm."""
    _register_fonts()
    return float(pdfmetrics.stringWidth(words, BOLD if bold else REGULAR, points)) / POINTS_PER_MM


def wrapped(words: str, points: float, width: float, *, bold: bool = False) -> list[str]:
    """The text in lines of at most ``width`` mm; a word that is longer than a line is broken anywhere."""
    lines: list[str] = []
    line = ""
    for word in words.split():
        longer = f"{line} {word}" if line else word
        if text_width(longer, points, bold=bold) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        line = word
        while text_width(line, points, bold=bold) > width and len(line) > 1:
            fits = next(
                (count for count in range(len(line), 1, -1) if text_width(line[:count], points, bold=bold) <= width), 1
            )
            lines.append(line[:fits])
            line = line[fits:]
    return [*lines, line] if line else lines


def rectangle(x: float, y: float, width: float, height: float) -> Array:
    """A rectangle's corners (4, 2)."""
    return np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])


@cache
def _register_fonts() -> None:
    """Bitstream Vera, which comes with reportlab."""
    import reportlab

    folder = Path(reportlab.__file__).parent / "fonts"
    for name in (REGULAR, BOLD):
        pdfmetrics.registerFont(TTFont(name, str(folder / f"{name}.ttf")))


def _grey(level: float) -> Color:
    return Color(level, level, level)
