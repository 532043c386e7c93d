"""Read the cells of many quads at once: homographies, sampling, black and white of their borders, shadows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.detect.markers.base import Grey
from services.detect.markers.edges import read

Array = NDArray[np.float64]
Levels = NDArray[np.float32]

WITHIN_CELL = np.array([-0.2, 0.2])
"""Where a cell is read, in both directions: near its middle."""
PAPER_AT = 0.35
"""How far outside the black square, in cells, its paper is read: narrow margins shall do."""
LEAST_SPREAD = 6.0
"""Standard deviation of the border's levels, black and paper together: half of their contrast."""
LEAST_INNER = 0.3
"""The inner cells' standard deviation as a share of the border's: a plain square is no marker."""
LEAST_BORDER = 0.6
"""Correlation of the border's levels with black inside white."""
LEAST_SPLIT = 0.8
"""The share of the border's variance that black and white on both sides of a shadow's edge explain."""
SHADOW_ANGLES, SHADOW_OFFSETS = 12, np.linspace(-0.36, 0.36, 7)
LEAST_SHADED_CONTRAST = 10.0


@dataclass(frozen=True)
class Cells:
    """The levels of K quads: ``inner`` (K, n * n) data cells, ``border`` (K, B) first black then paper."""

    inner: Levels
    border: Levels


class Reader:
    """Reads markers of ``cells`` x ``cells`` (black border included)."""

    def __init__(self, cells: int) -> None:
        inside = (np.arange(cells)[:, None] + 0.5 + WITHIN_CELL).ravel()
        steps = np.concatenate([[-PAPER_AT] * 2, inside, [cells + PAPER_AT] * 2]) / cells
        x, y = np.meshgrid(steps, steps)
        self._places = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        self._size = cells + 2
        index = np.arange(self._size**2).reshape(self._size, self._size)
        self._inner = index[2:-2, 2:-2].ravel()
        black, paper = _frame(index[1:-1, 1:-1]), _frame(index)[:-4]
        self._border = np.concatenate([black, paper])
        self._is_paper = np.repeat([False, True], [len(black), len(paper)])
        pattern = self._is_paper - self._is_paper.mean()
        self._pattern = (pattern / np.linalg.norm(pattern)).astype(np.float32)
        self._sides = _half_planes(self._size)

    def cells(self, grey: Grey, quads: Array) -> Cells:
        """The levels of quads (K, 4, 2) px, clockwise."""
        projected = _homographies(quads) @ self._places
        places = projected[:, :2] / projected[:, 2:]
        levels = read(grey, places[:, 0], places[:, 1])
        grid = levels.reshape(-1, self._size, 2, self._size, 2).mean(axis=(2, 4)).reshape(len(quads), -1)
        return Cells(grid[:, self._inner], grid[:, self._border])

    def bordered(self, cells: Cells) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which of them (K,) have contrast at all, and which a border of black inside white."""
        centred = cells.border - cells.border.mean(axis=1, keepdims=True)
        length = np.linalg.norm(centred, axis=1)
        spread = length / np.sqrt(centred.shape[1])
        contrasty = (spread > LEAST_SPREAD) & (cells.inner.std(axis=1) > LEAST_INNER * spread)
        return contrasty, contrasty & (centred @ self._pattern > LEAST_BORDER * length)

    def without_shadow(self, cells: Cells) -> tuple[Levels, NDArray[np.bool_]]:
        """Inner levels (K, n * n), 0 black to 1 white, as if no shadow's edge lay across; where there is one.

        The straight line that parts the border best into two lights is found from the border alone, so that
        a pattern can't bring about its own discovery.
        """
        lit = self._sides[:, self._border]
        black, white = self._lights(cells, lit, paper=False), self._lights(cells, lit, paper=True)
        left = black.residual + white.residual
        best = left.argmin(axis=1)
        row = np.arange(len(best))
        total = np.square(cells.border - cells.border.mean(axis=1, keepdims=True)).sum(axis=1)
        dark = [levels[row, best] for levels in (black.shaded, black.lit)]
        bright = [levels[row, best] for levels in (white.shaded, white.lit)]
        contrast = np.minimum(bright[0] - dark[0], bright[1] - dark[1])
        parted = (left[row, best] < (1 - LEAST_SPLIT) * total) & (contrast > LEAST_SHADED_CONTRAST)
        side = self._sides[best][:, self._inner]
        low = np.where(side, dark[1][:, None], dark[0][:, None])
        range_ = np.where(side, (bright[1] - dark[1])[:, None], (bright[0] - dark[0])[:, None])
        levels = (cells.inner - low) / np.where(parted[:, None], range_, 1.0)
        return np.clip(levels, -0.3, 1.3).astype(np.float32), parted

    def _lights(self, cells: Cells, lit: NDArray[np.bool_], *, paper: bool) -> _Lights:
        """Mean levels (K, S) of the black or the paper on both sides of each parting line."""
        of = self._is_paper if paper else ~self._is_paper
        values = cells.border[:, of].astype(np.float64)
        sides = lit[:, of].T.astype(np.float64)
        count = sides.sum(axis=0)
        sums = values @ sides
        lit_level = sums / np.maximum(count, 1)
        shaded_level = (values.sum(axis=1, keepdims=True) - sums) / np.maximum(len(sides) - count, 1)
        explained = lit_level**2 * count + shaded_level**2 * (len(sides) - count)
        return _Lights(lit_level, shaded_level, np.square(values).sum(axis=1, keepdims=True) - explained)


@dataclass(frozen=True)
class _Lights:
    lit: Array
    shaded: Array
    residual: Array


def _frame(index: NDArray[np.intp]) -> NDArray[np.intp]:
    """The outermost cells of a square of indices; its four corners last."""
    corners = index[[0, 0, -1, -1], [0, -1, -1, 0]]
    return np.concatenate([index[0, 1:-1], index[-1, 1:-1], index[1:-1, 0], index[1:-1, -1], corners])


def _half_planes(size: int) -> NDArray[np.bool_]:
    """(S, size * size): the cells on one side of straight lines through the marker."""
    at = (np.arange(size) + 0.5) / size - 0.5
    x, y = np.meshgrid(at, at)
    angles = np.arange(SHADOW_ANGLES) * np.pi / SHADOW_ANGLES
    return np.array(
        [
            (x * np.cos(angle) + y * np.sin(angle)).ravel() > offset
            for angle in angles
            for offset in SHADOW_OFFSETS * (size - 2) / size
        ]
    )


def _homographies(quads: Array) -> Array:
    """(K, 3, 3): unit square to quads (K, 4, 2), in closed form (P. Heckbert, 1989, section 2.2.3)."""
    (x0, x1, x2, x3), (y0, y1, y2, y3) = quads[:, :, 0].T, quads[:, :, 1].T
    ax, bx, cx = x1 - x2, x3 - x2, x0 - x1 + x2 - x3
    ay, by, cy = y1 - y2, y3 - y2, y0 - y1 + y2 - y3
    det = ax * by - bx * ay
    det = np.where(np.abs(det) < 1e-9, 1e-9, det)
    g, h = (cx * by - bx * cy) / det, (ax * cy - cx * ay) / det
    rows = [x1 - x0 + g * x1, x3 - x0 + h * x3, x0, y1 - y0 + g * y1, y3 - y0 + h * y3, y0, g, h, np.ones_like(g)]
    return np.stack(rows, axis=-1).reshape(-1, 3, 3)
