"""Which marker of a family do the grey levels of a grid of cells show?

The levels are not turned into bits: their correlation with each marker's pattern, as it looks sharp and
blurred by a share of a cell, is the evidence. Small and blurred markers keep it long after single bits are
lost. How much correlation is enough follows from chance: with n free levels, Fisher's z = atanh(r) sqrt(n - 3)
is a standard normal variable where there is no marker (R. A. Fisher, Metron 1921).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, sqrt, tanh
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from common.markers import Family

Array = NDArray[np.float32]

BY_CHANCE = 1e-6
"""How often a quad of random levels may pass for any of the family's markers."""
LEAST_SCORE = 0.88
"""Neighbouring pixels of real pictures are alike, so their levels are less free than Fisher assumes."""
LEAST_LEAD = 0.15
"""Before the next pattern (another id or another turn); families of close patterns have half their clean lead."""
LEAST_SUM = 1.08
"""Score and lead together: a low score needs a clear lead. Less by as much as the family's lead is."""
BLURS = ((0.0, 0.0), (0.4, 0.4), (0.6, 0.6), (0.8, 0.8), (0.9, 0.2), (0.2, 0.9))
"""Standard deviations along a row and a column, in cells: sharp, small or out of focus, moving."""
ONE_THREAD_PRODUCT = 250_000
"""Multiplications. Threads cost more than they bring here, and a detect process shall take one core."""
SHORT_LIST = 6
"""So many patterns, the best when taken as sharp, are compared in all blurs."""


@dataclass(frozen=True)
class Match:
    """What K grids show: marker, quarter turns of the seen pattern, score; ``sure`` where that is beyond doubt."""

    ids: NDArray[np.intp]
    turns: NDArray[np.intp]
    scores: Array
    sure: NDArray[np.bool_]


class CodeBook:
    """The patterns of a family. Grids are (n, n) levels of the cells, black border not included."""

    def __init__(self, family: Family) -> None:
        patterns = np.array([np.rot90(_papered(family, one), turn) for one in range(family.ids) for turn in range(4)])
        self._blurred = np.array([_normalised(_blur(patterns, *blur)) for blur in BLURS])
        self._sharp = np.ascontiguousarray(self._blurred[0].T)
        free = family.bits**2
        rarity = NormalDist().inv_cdf(1 - BY_CHANCE / len(patterns))
        self.least_score = max(LEAST_SCORE, tanh(rarity / sqrt(max(free - 3, 1))))
        self.least_lead = min(LEAST_LEAD, family.distance / free)
        self._least_sum = LEAST_SUM - LEAST_LEAD + self.least_lead

    def match(self, grids: Array) -> Match:
        """The best pattern for each of the grids (K, n * n), of any gain and offset."""
        if not len(grids):
            none = np.empty(0, dtype=np.intp)
            return Match(none, none, np.empty(0, dtype=np.float32), np.empty(0, dtype=np.bool_))
        levels = _normalised(grids)
        rough = self._correlations(levels)
        listed = _best(rough, min(SHORT_LIST, rough.shape[1]))
        length = listed.shape[1]
        scores = np.einsum("bklc,kc->kbl", self._blurred[:, listed], levels)
        row = np.arange(len(levels))
        blur, first = np.divmod(scores.reshape(len(levels), -1).argmax(axis=1), length)
        best = scores[row, blur, first]
        pattern = listed[row, first]
        # All patterns of a picture are blurred alike: the next one is sought in the best one's blur.
        alike = scores[row, blur]
        alike[row, first] = -1.0
        lead = best - alike.max(axis=1)
        sure = (best >= self.least_score) & (lead >= self.least_lead) & (best + lead >= self._least_sum)
        return Match(pattern // 4, pattern % 4, best, sure)

    def confirm(self, grids: Array, ids: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which grids (K, n * n) show the upright marker (K,) that is expected there: no other is in question."""
        expected = self._blurred[:, ids * 4]
        scores = np.einsum("bkc,kc->bk", expected, _normalised(grids)).max(axis=0)
        return np.asarray(scores >= self.least_score)

    def _correlations(self, levels: Array) -> Array:
        """Correlation (K, P) with each sharp pattern, in products too small for the BLAS to start threads for."""
        rows = max(ONE_THREAD_PRODUCT // self._sharp.size, 1)
        parts = [levels[at : at + rows] @ self._sharp for at in range(0, len(levels), rows)]
        return np.asarray(np.concatenate(parts), dtype=np.float32)


def _best(scores: Array, count: int) -> NDArray[np.intp]:
    """The columns (K, count) of each row's highest ``scores`` (K, P), which are lost; faster than a partition."""
    row = np.arange(len(scores))
    listed = np.empty((len(scores), count), dtype=np.intp)
    for place in range(count):
        listed[:, place] = scores.argmax(axis=1)
        scores[row, listed[:, place]] = -np.inf
    return listed


def _papered(family: Family, marker: int) -> Array:
    """A marker's cells with one cell of white paper around, as levels -1 and 1."""
    paper = np.pad(family.bitmap(marker).astype(np.float32), 1, constant_values=1.0)
    return 2 * paper - 1


def _blur(patterns: Array, along_row: float, along_column: float) -> Array:
    """Blurred patterns (P, n * n) without paper and border; blur in cells."""
    size = patterns.shape[1]
    seen = _kernel(size, along_column) @ patterns @ _kernel(size, along_row).T
    return np.asarray(seen[:, 2:-2, 2:-2], dtype=np.float32).reshape(len(patterns), -1)


def _kernel(size: int, sigma: float) -> Array:
    """Row i: the shares (size,) that the cells have in the level at cell i's centre; the outermost cells go on."""
    if not sigma:
        return np.eye(size, dtype=np.float32)
    edges = np.array([[erf((j - i) / sigma / sqrt(2)) / 2 for j in np.arange(size + 1) - 0.5] for i in range(size)])
    edges[:, 0], edges[:, -1] = -0.5, 0.5
    return np.diff(edges, axis=1).astype(np.float32)


def _normalised(levels: Array) -> Array:
    """Mean 0 and length 1 in each row; a row of equal levels becomes zeros."""
    centred = levels - levels.mean(axis=1, keepdims=True)
    length = np.linalg.norm(centred, axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(length, 1e-6), dtype=np.float32)
