"""Drawings over the picture's area, as SVG: where corners were seen, how they are off, how sure a projection is."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from common.calibration import Solution
from tools.report.plot import COLOURS, INK, MUTED

_WIDTH = 640.0
_TOP = 34.0
_FONT = "font-family='system-ui, sans-serif'"
_ARROW_PX = 40.0
"""On the drawing, an arrow of the 95th percentile's length."""
_LIGHT, _DEEP = np.array([236, 243, 250]), np.array([120, 20, 60])


def coverage_map(solution: Solution) -> str:
    """Every corner that was used, over the picture; single views in turning colours."""
    width, height = solution.camera.width, solution.camera.height
    scale = _WIDTH / width
    parts = []
    for number, view in enumerate(solution.views):
        colour = COLOURS[number % len(COLOURS)]
        parts += [
            f"<circle cx='{(x + 0.5) * scale:.1f}' cy='{_TOP + (y + 0.5) * scale:.1f}' r='2.2' fill='{colour}'/>"
            for x, y in view.corners
        ]
    return _framed("Corners that were used", width, height, parts)


def residual_map(solution: Solution) -> str:
    """Which way corners are off, enlarged: no pattern must be left in it."""
    width, height = solution.camera.width, solution.camera.height
    scale = _WIDTH / width
    lengths = np.concatenate([np.linalg.norm(one, axis=1) for one in solution.fit.residuals])
    factor = _ARROW_PX / max(float(np.percentile(lengths, 95)), 1e-9) / 2
    parts = []
    for view, residual in zip(solution.views, solution.fit.residuals, strict=True):
        for (x, y), (dx, dy) in zip(view.corners, residual, strict=True):
            start = ((x + 0.5) * scale, _TOP + (y + 0.5) * scale)
            parts.append(
                f"<path d='M{start[0]:.1f} {start[1]:.1f}l{dx * factor:.1f} {dy * factor:.1f}' "
                f"stroke='{COLOURS[0]}' stroke-width='1' stroke-opacity='.6'/>"
            )
    return _framed(f"Residuals, {factor / scale:.0f} times enlarged", width, height, parts)


def projection_map(solution: Solution) -> str:
    """Standard deviation of a projected point over the picture."""
    found = solution.map
    width, height = solution.camera.width, solution.camera.height
    scale = _WIDTH / width
    columns, rows = len(found.x), len(found.y)
    cell_w, cell_h = _WIDTH / columns, height * scale / rows
    top = float(np.nanmax(found.sd_px)) if np.isfinite(found.sd_px).any() else 1.0
    low = float(np.nanmin(found.sd_px)) if np.isfinite(found.sd_px).any() else 0.0
    parts = []
    for row in range(rows):
        for column in range(columns):
            value = float(found.sd_px[row, column])
            x, y = column * cell_w, _TOP + row * cell_h
            deep = 1.0 if not np.isfinite(value) else _depth(value, low, top)
            fill, ink = _colour(deep), "#ffffff" if deep > 0.5 else INK
            text = "none" if not np.isfinite(value) else f"{value:.2f}" if value < 10 else f"{value:.0f}"
            parts.append(
                f"<rect x='{x:.1f}' y='{y:.1f}' width='{cell_w + 0.3:.1f}' height='{cell_h + 0.3:.1f}' fill='{fill}'/>"
                f"<text x='{x + cell_w / 2:.1f}' y='{y + cell_h / 2 + 4:.1f}' font-size='11' text-anchor='middle' "
                f"{_FONT} fill='{ink}'>{text}</text>"
            )
    title = f"Uncertainty of a projection, px (one standard deviation), {found.distance_mm:.0f} mm away"
    return _framed(title, width, height, parts)


def _depth(value: float, low: float, top: float) -> float:
    """0 to 1 on a logarithmic scale."""
    if top <= low or low <= 0:
        return 0.0
    return float(np.log(value / low) / np.log(top / low))


def _colour(deep: float) -> str:
    mixed: NDArray[np.float64] = _LIGHT + (_DEEP - _LIGHT) * deep
    red, green, blue = (round(float(value)) for value in mixed)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _framed(title: str, width: int, height: int, parts: list[str]) -> str:
    drawn = height * _WIDTH / width
    total = drawn + _TOP + 24
    size = f"viewBox='-1 0 {_WIDTH + 2:.0f} {total:.0f}' width='{_WIDTH + 2:.0f}' height='{total:.0f}'"
    return "\n".join(
        [
            f"<svg xmlns='http://www.w3.org/2000/svg' {size} role='img' aria-label='{escape(title, quote=True)}'>",
            f"<rect x='-1' width='{_WIDTH + 2:.0f}' height='{total:.0f}' fill='#ffffff'/>",
            f"<text x='4' y='22' font-size='15' font-weight='600' {_FONT} fill='{INK}'>{escape(title)}</text>",
            *parts,
            f"<rect x='0' y='{_TOP}' width='{_WIDTH}' height='{drawn:.1f}' fill='none' stroke='{MUTED}'/>",
            f"<text x='4' y='{total - 7:.0f}' font-size='12' {_FONT} fill='{MUTED}'>{width} x {height} px</text>",
            "</svg>",
        ]
    )
