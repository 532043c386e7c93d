"""A report as one HTML file that needs nothing else: headings, paragraphs, tables, plots."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.report.files import write_text

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #14181f; background: #f6f7f9; margin: 0; }
main { max-width: 60rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; background: #fff; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .7rem; border: 1px solid #dde1e6; text-align: right; }
th { background: #eceff3; font-weight: 600; } th:first-child, td:first-child { text-align: left; }
table.words td, table.words th { vertical-align: top; }
table.words td:last-child, table.words th:last-child { text-align: left; }
table.words td:first-child { white-space: nowrap; }
figure { margin: 1rem 0; } svg, img { max-width: 100%; height: auto; border: 1px solid #dde1e6; }
.notes { color: #4a5361; }
"""
_JPEG_QUALITY = 82
_WORDS = 40
"""Characters from which on a table's last column is text and not a number."""


class Page:
    """Collects a report from top to bottom."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts = [f"<h1>{escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """A section's heading."""
        self._parts.append(f"<h2>{escape(text)}</h2>")

    def text(self, text: str) -> None:
        """A paragraph."""
        self._parts.append(f"<p>{escape(text)}</p>")

    def note(self, text: str) -> None:
        """A paragraph of small importance: how it was measured."""
        self._parts.append(f"<p class='notes'>{escape(text)}</p>")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table; the first column names the row, the last may be a sentence.

        Raises ValueError for a row of another length.
        """
        head = "".join(f"<th scope='col'>{escape(column)}</th>" for column in columns)
        body = []
        for row in rows:
            if len(row) != len(columns):
                raise ValueError(f"a row has {len(row)} cells, the table {len(columns)} columns")
            body.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>")
        words = " class='words'" if any(len(row[-1]) > _WORDS for row in rows if row) else ""
        self._parts.append(
            f"<div class='scroll'><table{words}><thead><tr>{head}</tr></thead>"
            f"<tbody>{''.join(body)}</tbody></table></div>"
        )

    def figure(self, svg: str) -> None:
        """A plot of ``tools.report.plot``."""
        self._parts.append(f"<figure>{svg}</figure>")

    def picture(self, bgr: NDArray[np.uint8], alt: str) -> None:
        """A picture (H, W, 3), kept in the document; ``alt`` says what it shows."""
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        text = base64.b64encode(data.tobytes()).decode()
        self._parts.append(
            f"<figure><img src='data:image/jpeg;base64,{text}' width='{bgr.shape[1]}' height='{bgr.shape[0]}' "
            f"alt='{escape(alt, quote=True)}'></figure>"
        )

    def html(self) -> str:
        """The whole document."""
        return (
            "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
            "<meta name='viewport' content='width=device-width, initial-scale=1'>"
            f"<title>{escape(self._title)}</title><style>{_STYLE}</style></head>\n<body><main>\n"
            + "\n".join(self._parts)
            + "\n</main></body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Write the document (see ``write_text``)."""
        write_text(self.html(), path)
