"""A marker's pattern as blurred edges in closed form, and where on it to look.

Coordinates are cells: (0, 0) is the black square's top left corner, (n, n) its bottom right one, u right, v down.
Around the square lies an endless white margin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from common.markers import Bitmap

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

# erf(x) = 1 - (a1 t + ... + a5 t^5) exp(-x^2), t = 1 / (1 + p x), to 1.5e-7 (Abramowitz, Stegun 7.1.26);
# numpy has no erf of its own, and the exponential is needed for the derivative anyway.
_ERF = (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429)
_ERF_P = 0.3275911
_NARROW = 0.15
"""Blurs (cells) below which only the nearest edge is felt: of the next one less than a two thousandth arrives."""


@dataclass(frozen=True, slots=True)
class Values:
    """The pattern at N points, 0 black ... 1 white: value, its slope along u and v (per cell), and by blur.

    ``by_log_blur`` is the derivative by the logarithm of a blur that widens u and v alike. All (N,).
    """

    value: Floats
    by_u: Floats
    by_v: Floats
    by_log_blur: Floats


class Pattern:
    """One marker's pattern; made from its cells (n, n) in 0/1, upright."""

    def __init__(self, cells: Bitmap) -> None:
        self.cells = len(cells)
        framed = np.pad(cells.astype(np.float32), 1, constant_values=1.0)
        # The pattern is a sum of quarter planes: step(v - f) step(u - e), weighted by the second difference.
        # The first row and column stand for "no step", the value far left of and above everything.
        across = np.diff(framed, axis=1, prepend=0.0)
        self._steps: Floats = np.diff(across, axis=0, prepend=0.0)
        self._edges: Floats = np.arange(self.cells + 1, dtype=np.float32)
        self._sides = self._transitions(framed)
        # Where two edges cross: the cell before both, and what a step over the upright, the level and both edges adds.
        before, right, down = framed[:-1, :-1], framed[:-1, 1:], framed[1:, :-1]
        crossings = (before, right - before, down - before, self._steps[1:, 1:])
        self._crossings: Floats = np.stack([table.ravel() for table in crossings])

    def sample(self, along: int, across: Array, cell_px: tuple[float, float]) -> Array:
        """Points (N, 2) around all edges of the pattern, in cells.

        ``along`` points on each edge of one cell, each repeated at the distances ``across`` (px) from it;
        ``cell_px`` is the size of a cell in the picture along u and v.
        """
        upright, level = self._sides
        places = (np.arange(along) + 0.5) / along
        parts = []
        for edges, axis in ((upright, 0), (level, 1)):
            around = np.empty((along, len(across), 2))
            around[..., axis] = across / cell_px[axis]
            around[..., 1 - axis] = places[:, None]
            parts.append((edges[:, None] + around.reshape(-1, 2)).reshape(-1, 2))
        return np.concatenate(parts)

    def at(self, u: Floats, v: Floats, blur_u: Floats, blur_v: Floats, skew: Floats | None = None) -> Values:
        """The pattern at points (N,), blurred by Gaussians of ``blur_u`` and ``blur_v`` (N,), all in cells.

        ``skew`` (N,) is the correlation of the two blurs: not 0 where rows and columns don't meet squarely in the
        picture. It matters where edges meet; its slopes are left out.
        """
        if max(float(blur_u.max()), float(blur_v.max())) < _NARROW:
            return self._near_at(np.stack([u, v]), np.stack([blur_u, blur_v]), skew)
        step_u, slope_u, widen_u = self._blurred(u, blur_u)
        step_v, slope_v, widen_v = self._blurred(v, blur_v)
        rows = step_v @ self._steps
        columns = step_u @ self._steps.T
        value = np.einsum("ij,ij->i", rows, step_u)
        if skew is not None:
            value += self._skewed(skew, slope_u * blur_u[:, None], slope_v * blur_v[:, None], widen_u, widen_v)
        return Values(
            value=value,
            by_u=np.einsum("ij,ij->i", rows[:, 1:], slope_u),
            by_v=np.einsum("ij,ij->i", columns[:, 1:], slope_v),
            by_log_blur=np.einsum("ij,ij->i", rows[:, 1:], widen_u) + np.einsum("ij,ij->i", columns[:, 1:], widen_v),
        )

    def _near_at(self, at: Floats, blur: Floats, skew: Floats | None) -> Values:
        """The same for points (2, N), from the nearest upright and the nearest level edge of each alone."""
        edge = np.minimum(np.maximum(np.rint(at), 0.0), np.float32(self.cells))
        distance = (at - edge) / blur
        step, bell = _step(distance)
        crossing = (edge[1] * (self.cells + 1) + edge[0]).astype(np.intp)
        before, right, down, both = self._crossings.take(crossing, axis=1)
        over_u, over_v = right + both * step[1], down + both * step[0]
        value = before + right * step[0] + over_v * step[1]
        widen, slope = -distance * bell, bell / blur
        if skew is not None:
            value += skew * both * (bell[0] * bell[1] + 0.5 * skew * widen[0] * widen[1])
        return Values(value, over_u * slope[0], over_v * slope[1], over_u * widen[0] + over_v * widen[1])

    def _skewed(self, skew: Floats, bell_u: Floats, bell_v: Floats, widen_u: Floats, widen_v: Floats) -> Floats:
        """What correlated blurs add: the first two terms of the tetrachoric series (Pearson 1900)."""
        crossings = self._steps[1:, 1:]
        first = np.einsum("ij,ij->i", bell_v @ crossings, bell_u)
        second = np.einsum("ij,ij->i", widen_v @ crossings, widen_u)
        return np.asarray(skew * first + 0.5 * skew * skew * second)

    def _blurred(self, at: Floats, blur: Floats) -> tuple[Floats, Floats, Floats]:
        """Blurred steps (N, n+2), led by a column of ones; slopes and derivatives by log blur (N, n+1)."""
        inverse = (1.0 / blur)[:, None]
        distance = (at[:, None] - self._edges) * inverse
        steps = np.ones((len(at), self.cells + 2), dtype=np.float32)
        steps[:, 1:], bell = _step(distance)
        return steps, bell * inverse, -distance * bell

    @staticmethod
    def _transitions(framed: Floats) -> tuple[Array, Array]:
        """Start points (u, v) of all edges of one cell between black and white: upright ones, level ones."""
        row, column = np.nonzero(np.diff(framed, axis=1)[1:-1, :])
        upright = np.column_stack([column, row])
        row, column = np.nonzero(np.diff(framed, axis=0)[:, 1:-1])
        level = np.column_stack([column, row])
        return upright.astype(np.float64), level.astype(np.float64)


def _step(distance: Floats) -> tuple[Floats, Floats]:
    """The normal distribution up to ``distance`` sigma (a blurred step), and its density."""
    bell = np.exp(-0.5 * distance * distance)
    t = 1.0 / (1.0 + (_ERF_P * np.float32(np.sqrt(0.5))) * np.abs(distance))
    a1, a2, a3, a4, a5 = _ERF
    tail = 0.5 * (((((a5 * t + a4) * t) + a3) * t + a2) * t + a1) * t * bell
    bell *= np.float32(1.0 / np.sqrt(2.0 * np.pi))
    return np.where(distance > 0, 1.0 - tail, tail), bell


@lru_cache(maxsize=512)
def _cached(cells: bytes, size: int) -> Pattern:
    return Pattern(np.frombuffer(cells, dtype=np.uint8).reshape(size, size))


def pattern_of(cells: Bitmap) -> Pattern:
    """The pattern of these cells, made once."""
    return _cached(cells.tobytes(), len(cells))
