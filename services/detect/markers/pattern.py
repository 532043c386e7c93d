"""tagmill's own detector: dark quads, edges fitted to them, patterns correlated; no bits, no thresholds on cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey, Search
from services.detect.markers.code_book import CodeBook, Match
from services.detect.markers.dark_quads import Level, find_quads, signed_areas
from services.detect.markers.edges import fit_edges
from services.detect.markers.quads import as_quad, check, merged
from services.detect.markers.reading import Cells, Reader

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

KIND = "edges"
FAST = (Level(1, 0.5, 100), Level(0.5, 0.25, 50))
"""Whole pixels for the small, where a busy picture's markers must stand out; halved, with a low threshold and little
contrast, for the large, the blurred and the half shaded."""
THOROUGH = (Level(2, 0.5), *FAST, Level(1, 0.25), Level(0.5, 0.5), Level(0.25, 0.35))
DOUBLED_MAX_PIXELS = 4_000_000
"""A larger picture isn't doubled: its small markers have pixels enough."""
CELLS_OFF = 0.6
"""How far, in cells, a candidate's side may lie beside its edge."""
FOLLOWED_CELLS_OFF = 0.95
"""The same for a predicted marker. Beyond a cell the edges of inner cells look like the outer one."""
LEAST_REACH_PX = 1.0
LEAST_SHADED_SCORE = 0.92
"""Parting the lights adds freedom to the fit; true markers score 0.95 and more there."""
LEAST_CELL_PX = 0.7
"""In both directions: what is narrower holds no pattern that could be told."""
ALIKE_SHIFT, ALIKE_SIZE = 0.08, 0.15
"""Candidates of two levels are one: their centres' distance in sides (and a pixel), their sizes' ratio (log)."""


class PatternDetector:
    """Markers of one family. More ``levels`` (scales and thresholds) find more and take longer."""

    def __init__(self, family: Family, levels: Sequence[Level] = FAST) -> None:
        self.family = family
        self._levels = levels
        self._book = CodeBook(family)
        self._reader = Reader(family.cells)

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8; ``kind`` is ``edges``. Raises ValueError for another shape."""
        pieces = self.search(grey)
        while True:
            try:
                next(pieces)
            except StopIteration as through:
                return list(through.value)

    def search(self, grey: Grey) -> Search:
        """``detect`` in pieces; the picture must stay as it is until the last."""
        check(grey)
        quads, reach = np.empty((0, 4, 2)), np.empty(0)
        for level in self._levels:
            if level.scale > 1 and grey.size > DOUBLED_MAX_PIXELS:
                continue
            more, off = find_quads(grey, level)
            new = ~_known(more, quads)
            quads, reach = np.concatenate([quads, more[new]]), np.concatenate([reach, off[new]])
            yield
        if not len(quads):
            return []
        quads = fit_edges(grey, quads, np.maximum(reach, CELLS_OFF * self._cell_px(quads)))
        seen = sorted(self._identify(grey, quads), key=lambda one: -one.score)
        found = merged([(one.id, np.roll(one.quad, one.turn, axis=0)) for one in seen])
        return [DetectedMarker(id=marker, corners=as_quad(corners), kind=KIND) for marker, corners in found]

    def follow(self, grey: Grey, expected: Sequence[DetectedMarker]) -> list[DetectedMarker | None]:
        """Each expected marker where it is now, or None where it isn't within a cell of where it was expected.

        Looks at nothing but the expected markers' edges and cells.
        """
        check(grey)
        if not expected:
            return []
        quads = np.array([marker.corners for marker in expected], dtype=np.float64)
        quads = fit_edges(grey, quads, np.maximum(FOLLOWED_CELLS_OFF * self._cell_px(quads), LEAST_REACH_PX))
        quads = self._fit_closely(grey, quads)
        cells = self._reader.cells(grey, quads)
        ids = np.array([marker.id for marker in expected], dtype=np.intp)
        contrasty, bordered = self._reader.bordered(cells)
        seen = bordered & self._book.confirm(cells.inner, ids)
        if not seen.all():
            levels, parted = self._reader.without_shadow(cells)
            seen |= contrasty & parted & self._book.confirm(levels, ids)
        seen &= self._large_enough(quads)
        return [
            DetectedMarker(id=marker.id, corners=as_quad(quad), kind=KIND) if there else None
            for marker, quad, there in zip(expected, quads, seen, strict=True)
        ]

    def _identify(self, grey: Grey, quads: Array) -> list[_Seen]:
        """Those quads (K, 4, 2) that show a marker of the family, fitted once more."""
        contrasty, _ = self._reader.bordered(self._reader.cells(grey, quads))
        quads = quads[contrasty & self._large_enough(quads)]
        if not len(quads):
            return []
        quads = self._fit_closely(grey, quads)
        cells = self._reader.cells(grey, quads)
        contrasty, bordered = self._reader.bordered(cells)
        plain = np.flatnonzero(bordered)
        match = self._book.match(cells.inner[plain])
        seen = _sure(match, plain, quads)
        unread = contrasty.copy()
        unread[plain[match.sure]] = False
        return seen + self._in_shadow(cells, np.flatnonzero(unread), quads)

    def _in_shadow(self, cells: Cells, index: Indices, quads: Array) -> list[_Seen]:
        """Those of the quads ``index`` that show a marker once a shadow's edge is accounted for."""
        if not len(index):
            return []
        levels, parted = self._reader.without_shadow(Cells(cells.inner[index], cells.border[index]))
        shaded = index[parted]
        read = _sure(self._book.match(levels[parted]), shaded, quads)
        return [one for one in read if one.score >= LEAST_SHADED_SCORE]

    def _fit_closely(self, grey: Grey, quads: Array) -> Array:
        return fit_edges(grey, quads, np.maximum(CELLS_OFF / 2 * self._cell_px(quads), LEAST_REACH_PX))

    def _large_enough(self, quads: Array) -> NDArray[np.bool_]:
        """Which quads (K, 4, 2) have pixels enough for a cell, across as well as along."""
        sides = np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2)
        narrower = np.minimum(sides[:, 0] + sides[:, 2], sides[:, 1] + sides[:, 3]) / 2
        return np.asarray(
            np.minimum(narrower, np.sqrt(np.abs(signed_areas(quads)))) >= LEAST_CELL_PX * self.family.cells
        )

    def _cell_px(self, quads: Array) -> Array:
        """The side of a cell (K,), px, if the quads were markers."""
        return np.asarray(np.sqrt(np.abs(signed_areas(quads))) / self.family.cells)


@dataclass(frozen=True)
class _Seen:
    """A quad that was read: what it shows, and by how many quarter turns it is turned."""

    id: int
    turn: int
    score: float
    quad: Array


def _sure(match: Match, index: Indices, quads: Array) -> list[_Seen]:
    return [
        _Seen(int(match.ids[k]), int(match.turns[k]), float(match.scores[k]), quads[at])
        for k, at in enumerate(index)
        if match.sure[k]
    ]


def _known(quads: Array, others: Array) -> NDArray[np.bool_]:
    """Which quads (K, 4, 2) lie where one of the others (L, 4, 2) lies and are as large."""
    if not len(quads) or not len(others):
        return np.zeros(len(quads), dtype=np.bool_)
    side, other_side = (np.sqrt(np.abs(signed_areas(these))) for these in (quads, others))
    apart = np.linalg.norm(quads.mean(axis=1)[:, None] - others.mean(axis=1), axis=-1)
    ratio = np.abs(np.log(side[:, None] / other_side))
    return np.asarray(((apart < ALIKE_SHIFT * other_side + 1.0) & (ratio < ALIKE_SIZE)).any(axis=1))
