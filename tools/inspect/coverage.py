"""From where the objects were seen, as SVG: a map of the view sphere, one field for each 30 degrees."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from tools.inspect.summary import AZIMUTHS, ELEVATIONS
from tools.report.plot import GRID, INK, MUTED

_WIDE, _HIGH, _LEFT, _TOP = 50.0, 32.0, 76.0, 46.0
_FONT = "font-family='system-ui, sans-serif'"
_LIGHT, _DARK = np.array([233.0, 242.0, 250.0]), np.array([11.0, 76.0, 150.0])
_ON_DARK = 0.45
_NAMED = {0: "front", 3: "right", 6: "back", 9: "left"}


def coverage_map(name: str, cells: Sequence[Sequence[int]]) -> str:
    """The map of one object: columns azimuth (0 before the front, 90 at its right side), rows elevation downwards."""
    most = max((count for row in cells for count in row), default=0)
    step_a, step_e = 360 // AZIMUTHS, 180 // ELEVATIONS
    width, height = _LEFT + AZIMUTHS * _WIDE + 16, _TOP + ELEVATIONS * _HIGH + 44
    title = f"{name}: samples by the direction it was seen from"
    parts = [
        (
            f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width:.0f} {height:.0f}' width='{width:.0f}' "
            f"height='{height:.0f}' role='img' aria-label='{escape(title, quote=True)}'>"
        ),
        f"<rect width='{width:.0f}' height='{height:.0f}' fill='#ffffff'/>",
        _text(_LEFT, 24, title, anchor="start", colour=INK, size=15, weight=600),
    ]
    for row, counts in enumerate(cells):
        top = _TOP + row * _HIGH
        high = 90 - row * step_e
        parts.append(_text(_LEFT - 8, top + _HIGH / 2 + 4, f"{high - step_e}° to {high}°", anchor="end", size=11))
        for column, count in enumerate(counts):
            parts += _cell(_LEFT + column * _WIDE, top, count, most)
    for column in range(AZIMUTHS):
        at = _LEFT + column * _WIDE
        under = _TOP + ELEVATIONS * _HIGH
        parts.append(_text(at, under + 15, f"{column * step_a}°", size=11))
        if column in _NAMED:
            parts.append(_text(at, under + 31, _NAMED[column], colour=INK, size=12))
    return "\n".join([*parts, "</svg>"])


def _cell(left: float, top: float, count: int, most: int) -> list[str]:
    if count == 0:
        return [
            (
                f"<rect x='{left + 1:.1f}' y='{top + 1:.1f}' width='{_WIDE - 2}' height='{_HIGH - 2}' fill='none' "
                f"stroke='{GRID}'/>"
            )
        ]
    share = count / most
    red, green, blue = np.rint(_LIGHT + (_DARK - _LIGHT) * np.sqrt(share)).astype(int)
    ink = "#ffffff" if np.sqrt(share) > _ON_DARK else INK
    return [
        (
            f"<rect x='{left + 1:.1f}' y='{top + 1:.1f}' width='{_WIDE - 2}' height='{_HIGH - 2}' "
            f"fill='rgb({red},{green},{blue})'/>"
        ),
        _text(left + _WIDE / 2, top + _HIGH / 2 + 4, str(count), colour=ink, size=12),
    ]


def _text(
    x: float, y: float, text: str, *, anchor: str = "middle", colour: str = MUTED, size: int = 13, weight: int = 400
) -> str:
    return (
        f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' font-size='{size}' font-weight='{weight}' {_FONT} "
        f"fill='{colour}'>{escape(text)}</text>"
    )
