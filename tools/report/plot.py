"""Plots as SVG, written by hand: series of points with ranges over two axes. One for all tools."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

INK, MUTED, GRID = "#14181f", "#4a5361", "#dde1e6"
COLOURS = ("#0b66c3", "#c2410c", "#3f7d20", "#7a3ea8", "#a1740a")
"""Told apart by people who don't see all colours, too; series also differ in their marks."""
_MARKS = ("circle", "square", "diamond")
_LEFT, _RIGHT, _TOP, _BOTTOM = 64.0, 18.0, 40.0, 52.0
_LEGEND_ROW = 20.0
_FEW_DECADES = 2.0
"""On a logarithmic axis of less than this, 2 and 5 are ticks, too."""
_FONT = "font-family='system-ui, sans-serif'"


@dataclass(frozen=True)
class Series:
    """Points of one kind: ``low`` and ``high`` (a range at each point) may be left out.

    ``line`` joins the points; ``band`` fills between low and high instead of drawing whiskers.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    line: bool = True
    band: bool = False


@dataclass(frozen=True)
class Axis:
    """``label`` with its unit; ``ticks`` (value to text) for an axis of names; ``zero``: 0 must be on it.

    ``log``: powers of ten are equally far apart; values that are not positive are left out.
    """

    label: str
    ticks: Mapping[float, str] = field(default_factory=dict)
    zero: bool = False
    log: bool = False


def plot(title: str, x: Axis, y: Axis, series: Sequence[Series], *, width: int = 720, height: int = 380) -> str:
    """An SVG picture (text) of the series. Raises ValueError where there is no finite point at all."""
    legend = -(-len(series) // 3) * _LEGEND_ROW if len(series) > 1 else 0.0
    canvas = _Canvas(
        _scale(x, [value for one in series for value in one.x], _LEFT, width - _RIGHT, margin=0.04),
        _scale(y, [value for one in series for value in _extent(one)], height - _BOTTOM, _TOP + legend, margin=0.06),
    )
    size = f"viewBox='0 0 {width} {height}' width='{width}' height='{height}'"
    parts = [
        f"<svg xmlns='http://www.w3.org/2000/svg' {size} role='img' aria-label='{escape(title, quote=True)}'>",
        f"<rect width='{width}' height='{height}' fill='#ffffff'/>",
        _text(_LEFT, 22, title, size=15, colour=INK, weight=600),
        *_axes(canvas, x, y, width, height, _TOP + legend),
    ]
    for number, one in reversed(list(enumerate(series))):  # the first lies on top
        parts += _drawn(one, COLOURS[number % len(COLOURS)], _MARKS[number % len(_MARKS)], canvas)
    if legend:
        for number, one in enumerate(series):
            left = _LEFT + (number % 3) * (width - _LEFT - _RIGHT) / 3
            top = _TOP + (number // 3) * _LEGEND_ROW
            parts.append(_mark(_MARKS[number % len(_MARKS)], left + 6, top, COLOURS[number % len(COLOURS)]))
            parts.append(_text(left + 18, top + 4, one.name))
    return "\n".join([*parts, "</svg>"])


@dataclass(frozen=True)
class _Scale:
    """``low`` and ``high`` are logarithms on a logarithmic axis."""

    low: float
    high: float
    start: float
    end: float
    log: bool

    def at(self, value: float) -> float:
        return self.start + (_along(value, log=self.log) - self.low) / (self.high - self.low) * (self.end - self.start)

    def shows(self, value: float) -> bool:
        return bool(np.isfinite(_along(value, log=self.log)))

    def ticks(self, about: int) -> list[float]:
        if not self.log:
            return ticks(self.low, self.high, about)
        factors = (1, 2, 5) if self.high - self.low < _FEW_DECADES else (1,)
        decades = range(int(np.floor(self.low)), int(np.ceil(self.high)) + 1)
        values = [factor * 10.0**decade for decade in decades for factor in factors]
        return [value for value in values if self.low <= np.log10(value) <= self.high]


def _along(value: float, *, log: bool) -> float:
    if not log:
        return value
    return float(np.log10(value)) if value > 0 else float("nan")


@dataclass(frozen=True)
class _Canvas:
    x: _Scale
    y: _Scale


def _extent(series: Series) -> list[float]:
    return [*series.y, *(series.low or ()), *(series.high or ())]


def _scale(axis: Axis, values: Sequence[float], start: float, end: float, *, margin: float) -> _Scale:
    along = [_along(value, log=axis.log) for value in values]
    if not any(np.isfinite(value) for value in along):
        raise ValueError(f"nothing finite to plot along '{axis.label}'")
    finite = [value for value in along if np.isfinite(value)] + list(axis.ticks) + ([0.0] if axis.zero else [])
    low, high = min(finite), max(finite)
    room = (high - low) * margin or max(abs(high), 1.0) * margin
    return _Scale(0.0 if axis.zero and low == 0.0 else low - room, high + room, start, end, axis.log)


def ticks(low: float, high: float, about: int = 6) -> list[float]:
    """Round values (1, 2 or 5 times a power of ten apart) from low to high."""
    raw = (high - low) / about
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(next(factor for factor in (1, 2, 5, 10) if factor * power >= raw * 0.999) * power)
    first = int(np.ceil(low / step - 1e-9))
    return [number * step for number in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def _axes(canvas: _Canvas, x: Axis, y: Axis, width: int, height: int, top: float) -> list[str]:
    bottom, right = height - _BOTTOM, width - _RIGHT
    parts = []
    for value in canvas.y.ticks(6):
        at = canvas.y.at(value)
        colour = MUTED if value == 0 else GRID
        parts.append(f"<line x1='{_LEFT}' x2='{right}' y1='{at:.1f}' y2='{at:.1f}' stroke='{colour}'/>")
        parts.append(_text(_LEFT - 8, at + 4, f"{value:g}", anchor="end"))
    named = dict(x.ticks) or {value: f"{value:g}" for value in canvas.x.ticks(9)}
    for value, text in named.items():
        at = canvas.x.at(value)
        parts.append(f"<line x1='{at:.1f}' x2='{at:.1f}' y1='{bottom}' y2='{bottom + 5}' stroke='{MUTED}'/>")
        parts.append(_text(at, bottom + 19, text, anchor="middle"))
    parts.append(f"<line x1='{_LEFT}' x2='{right}' y1='{bottom}' y2='{bottom}' stroke='{MUTED}'/>")
    parts.append(_text((_LEFT + right) / 2, height - 12, x.label, anchor="middle"))
    middle = (top + bottom) / 2
    parts.append(
        f"<text transform='translate(16 {middle:.1f}) rotate(-90)' text-anchor='middle' font-size='13' {_FONT} "
        f"fill='{MUTED}'>{escape(y.label)}</text>"
    )
    return parts


def _drawn(series: Series, colour: str, mark: str, canvas: _Canvas) -> list[str]:
    points = [
        (canvas.x.at(x), canvas.y.at(y))
        for x, y in zip(series.x, series.y, strict=True)
        if canvas.x.shows(x) and canvas.y.shows(y)
    ]
    parts = _range(series, colour, canvas)
    if series.line and len(points) > 1:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f"<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='2'/>")
    return parts + [_mark(mark, x, y, colour) for x, y in points]


def _range(series: Series, colour: str, canvas: _Canvas) -> list[str]:
    if series.low is None or series.high is None:
        return []
    spans = [
        (canvas.x.at(x), canvas.y.at(low), canvas.y.at(high))
        for x, low, high in zip(series.x, series.low, series.high, strict=True)
        if canvas.x.shows(x) and canvas.y.shows(low) and canvas.y.shows(high)
    ]
    if series.band:
        outline = [(x, high) for x, _, high in spans] + [(x, low) for x, low, _ in reversed(spans)]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in outline)
        return [f"<polygon points='{path}' fill='{colour}' fill-opacity='0.16' stroke='none'/>"]
    return [
        f"<path d='M{x:.1f} {low:.1f}V{high:.1f}M{x - 5:.1f} {low:.1f}h10M{x - 5:.1f} {high:.1f}h10' "
        f"stroke='{colour}' stroke-width='1.5' fill='none'/>"
        for x, low, high in spans
    ]


def _mark(kind: str, x: float, y: float, colour: str) -> str:
    if kind == "circle":
        return f"<circle cx='{x:.1f}' cy='{y:.1f}' r='4' fill='{colour}'/>"
    turn = f" transform='rotate(45 {x:.1f} {y:.1f})'" if kind == "diamond" else ""
    return f"<rect x='{x - 3.6:.1f}' y='{y - 3.6:.1f}' width='7.2' height='7.2' fill='{colour}'{turn}/>"


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", size: int = 13, colour: str = MUTED, weight: int = 400
) -> str:
    return (
        f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' font-size='{size}' font-weight='{weight}' {_FONT} "
        f"fill='{colour}'>{escape(text)}</text>"
    )
