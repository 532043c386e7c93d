"""The outline of a pattern of cells: closed loops instead of one square a cell.

Two squares side by side show a hairline where a viewer or a printer smooths their edges; one outline can't.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vertex = tuple[int, int]


def outlines(black: NDArray[np.bool_]) -> tuple[Array, ...]:
    """Closed loops (n, 2) around the black cells of ``black`` (rows, columns), x right, y down, one cell = 1.

    Filled together by the even-odd rule they give the pattern again, holes and islands included. Corners only: the
    first point is not repeated.
    """
    ends = _edges(black)
    loops = []
    while ends:
        start = next(iter(ends))
        loop = [start]
        here = _follow(ends, start)
        while here != start:
            loop.append(here)
            here = _follow(ends, here)
        loops.append(_corners(np.array(loop, dtype=np.float64)))
    return tuple(loops)


def _edges(black: NDArray[np.bool_]) -> dict[Vertex, list[Vertex]]:
    """Where the border's unit edges that begin at a vertex lead, black always on the same hand."""
    rows, columns = black.shape
    framed = np.pad(black, 1)
    ends: defaultdict[Vertex, list[Vertex]] = defaultdict(list)
    for y in range(rows):
        for x in range(columns):
            if not black[y, x]:
                continue
            if not framed[y, x + 1]:
                ends[x, y].append((x + 1, y))
            if not framed[y + 1, x + 2]:
                ends[x + 1, y].append((x + 1, y + 1))
            if not framed[y + 2, x + 1]:
                ends[x + 1, y + 1].append((x, y + 1))
            if not framed[y + 1, x]:
                ends[x, y + 1].append((x, y))
    return dict(ends)


def _follow(ends: dict[Vertex, list[Vertex]], here: Vertex) -> Vertex:
    """Take an edge away from the vertex and go along it."""
    after = ends[here].pop()
    if not ends[here]:
        del ends[here]
    return after


def _corners(loop: Array) -> Array:
    """The loop without the points on its straight edges."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    return loop[np.any(before != after, axis=1)]
