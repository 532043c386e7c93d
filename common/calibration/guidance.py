"""What a guided calibration tells its operator after each frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from common.calibration.diversity import Spread
from common.calibration.verdict import Verdict
from common.calibration.views import View
from common.calibration.wishes import WANTED_PER_TILT, Wish, tilt_counts

Array = NDArray[np.float64]
Phase = Literal["looking", "moving", "holding", "taken", "refused", "done"]
NEXT_PHASES: dict[Phase, frozenset[Phase]] = {
    "looking": frozenset({"moving", "holding", "done"}),
    "moving": frozenset({"looking", "holding", "done"}),
    "holding": frozenset({"looking", "moving", "taken", "refused", "done"}),
    "taken": frozenset({"looking", "moving", "holding", "done"}),
    "refused": frozenset({"looking", "moving", "holding", "done"}),
    "done": frozenset(),
}
"""Which phase may follow which; any but done may go on. A frame is taken or refused only after the board was held."""


@dataclass(frozen=True, eq=False)
class Guidance:
    """What to tell the operator after a frame.

    ``words``: one sentence, what to do next or why this frame was not taken (``code`` then: no_board, partial, blurred,
    wrong_layout, near_duplicate, nothing_new, other_size, enough; of an order: dropped, nothing_to_drop; judging: a
    verdict is being worked out). ``held``: 0..1 of the time that the board must be still. ``wish``: the next pose,
    ``ghost`` (4, 2) the board's outline in it, px, TL TR BR BL; ``outline`` (4, 2): as it is seen now. ``taken``: the
    view, in the frame that was taken and no other. ``spread`` of the ``count`` views. ``size``: the pictures'.
    ``verdict``: of the newest fit; ``so_far``: what can be said of the views without one. ``dropped``: how
    many views were taken back so far.
    """

    phase: Phase
    words: str
    size: tuple[int, int]
    code: str = ""
    held: float = 0.0
    wish: Wish | None = None
    ghost: Array | None = None
    outline: Array | None = None
    taken: View | None = None
    count: int = 0
    spread: Spread | None = None
    missing: tuple[Wish, ...] = ()
    verdict: Verdict | None = None
    so_far: Verdict | None = None
    dropped: int = 0

    def document(self) -> dict[str, Any]:
        """For programs (JSON): polygons as lists of points, coverage as rows of counts."""
        seen, wish = self.spread, self.wish
        return {
            "phase": self.phase,
            "words": self.words,
            "size": list(self.size),
            "code": self.code,
            "held": round(self.held, 2),
            "next": None if wish is None else {"code": wish.code, "words": wish.words, "place": list(wish.place)},
            "ghost": _points(self.ghost),
            "outline": _points(self.outline),
            "taken": None if self.taken is None else self.taken.name,
            "views": self.count,
            "dropped": self.dropped,
            "cells": [] if seen is None else seen.cells.tolist(),
            "covered": 0.0 if seen is None else round(seen.covered, 3),
            "tilts": {} if seen is None else tilt_counts(seen),
            "tilts_wanted": WANTED_PER_TILT,
            "missing": [item.code for item in self.missing],
            "verdict": None if self.verdict is None else self.verdict.sentence,
            "lacks": [] if self.so_far is None else [reason.words for reason in self.so_far.reasons],
        }


def _points(polygon: Array | None) -> list[list[float]] | None:
    """Rounded; None where there is no polygon, or not all of it is before the camera."""
    if polygon is None or not np.isfinite(polygon).all():
        return None
    return [[round(float(x), 1), round(float(y), 1)] for x, y in polygon]
