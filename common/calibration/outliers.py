"""Views and single corners that contradict the others: named, with the reason, and left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted, adjust
from common.calibration.lens import Lens
from common.calibration.views import View

Array = NDArray[np.float64]
_VIEW_FACTOR = 2.5
"""A view is spoilt if its corners fit this many times worse than those of the median view."""
_CORNER_FACTOR = 6.0
"""A corner is wrong if it is off by this many robust standard deviations of a coordinate."""
_FEW_CORNERS = 0.06
"""At most this share of a view's corners is dropped alone; with more, the view is."""
_LEAST_PX = 0.15
"""Nothing is dropped for a misfit below this: so small it may be chance."""
_MOST_DROPPED = 0.34
"""If more of the views would go, they contradict each other and nobody can say which are right."""
_ROUNDS = 6


@dataclass(frozen=True)
class Dropped:
    """A view that was left out, and why. ``code``: outlier, repeated, surplus."""

    name: str
    code: str
    reason: str


@dataclass(frozen=True, eq=False)
class Sifted:
    """``views`` that remain (some without a few corners), ``dropped``, the last ``fit``, ``torn``: too many fell out.

    ``corners``: of each view of which corners were dropped, how many.
    """

    views: tuple[View, ...]
    dropped: tuple[Dropped, ...]
    corners: dict[str, int]
    fit: Adjusted
    torn: bool


def sift(views: Sequence[View], lens: Lens, theta: Array, poses: Array) -> Sifted:
    """Fit, drop the worst view or the wrong corners, and again until nothing sticks out."""
    kept, at = list(views), poses
    dropped: list[Dropped] = []
    corners: dict[str, int] = {}
    most = int(_MOST_DROPPED * len(views))
    while True:
        fit = _robust(kept, lens, theta, at)
        theta, at = fit.theta, fit.poses
        worst = _spoilt_view(kept, fit)
        if worst is not None:
            if len(dropped) >= most:
                return Sifted(tuple(kept), tuple(dropped), corners, fit, torn=True)
            dropped.append(worst[1])
            del kept[worst[0]]
            at = np.delete(at, worst[0], axis=0)
            continue
        fewer = [
            _without_wrong(view, residual, _scale(fit)) for view, residual in zip(kept, fit.residuals, strict=True)
        ]
        gone = {old.name: len(old.ids) - len(new.ids) for old, new in zip(kept, fewer, strict=True)}
        if not any(gone.values()) or len(corners) > _ROUNDS * len(views):
            return Sifted(tuple(kept), tuple(dropped), corners, fit, torn=False)
        corners |= {name: corners.get(name, 0) + count for name, count in gone.items() if count}
        kept = fewer


def _robust(views: Sequence[View], lens: Lens, theta: Array, poses: Array) -> Adjusted:
    first = adjust(views, lens, theta, poses, flat=True, huber_px=2.0, iterations=30)
    limit = max(3 * _scale(first), 0.05)
    return adjust(views, lens, first.theta, first.poses, flat=True, huber_px=limit, iterations=30)


def _scale(fit: Adjusted) -> float:
    """Robust standard deviation of a coordinate, px."""
    return float(1.4826 * np.median(np.abs(np.concatenate([residual.ravel() for residual in fit.residuals]))))


def _spoilt_view(views: Sequence[View], fit: Adjusted) -> tuple[int, Dropped] | None:
    """The worst view if it sticks out, judged without the few corners that alone may be wrong."""
    if len(views) < 4:
        return None
    scores = np.array([_trimmed(residual) for residual in fit.residuals])
    worst = int(np.argmax(scores))
    usual = float(np.median(scores))
    if scores[worst] <= max(_VIEW_FACTOR * usual, usual + _LEAST_PX):
        return None
    view = views[worst]
    off = float(np.linalg.norm(fit.residuals[worst], axis=1).max())
    why = f"its corners are off by {fit.view_rms[worst]:.2f} px rms, at most {off:.1f} (the median view: {usual:.2f})"
    guess = "moved or blurred while it was taken?" if view.edge_px > 4 else "corners misplaced, or the board bent?"
    return worst, Dropped(view.name, "outlier", f"{why}; {guess}")


def _trimmed(residual: Array) -> float:
    squares = np.sort((residual**2).sum(axis=1))
    return float(np.sqrt(squares[: len(squares) - int(_FEW_CORNERS * len(squares))].mean()))


def _without_wrong(view: View, residual: Array, scale: float) -> View:
    off = np.linalg.norm(residual, axis=1)
    wrong = off > max(_CORNER_FACTOR * scale, _LEAST_PX)
    if not wrong.any() or wrong.sum() > max(1, _FEW_CORNERS * len(off)):
        return view
    return view.kept(~wrong)
