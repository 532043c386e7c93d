"""Held-out reprojection error: how well a calibration predicts views that it has not seen (k-fold)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted, adjust, board_extent
from common.calibration.views import View

Array = NDArray[np.float64]
FOLDS = 5
LEAST_VIEWS = 3


@dataclass(frozen=True, eq=False)
class HeldOut:
    """``squares`` (n,): each view's mean squared corner distance when it was held out, px^2, its six pose parameters
    allowed for; ``counts`` (n,): its corners."""

    squares: Array
    counts: NDArray[np.int64]

    @property
    def rms(self) -> float:
        """Root mean square over all corners, px."""
        return float(np.sqrt((self.squares * self.counts).sum() / max(self.counts.sum(), 1)))

    @property
    def view_rms(self) -> Array:
        """Of each view (n,)."""
        return np.asarray(np.sqrt(self.squares))


def hold_out(views: Sequence[View], fit: Adjusted, *, flat: bool, tick: Callable[[], None] = lambda: None) -> HeldOut:
    """Fit anew without each fold in turn, from ``fit`` on, and see how the fold's views are predicted.

    A held-out view gets its own pose, nothing else. ``tick`` is called after each fold.
    """
    folds = min(FOLDS, len(views))
    if folds < LEAST_VIEWS:
        raise ValueError(f"{len(views)} views are too few to hold some out")
    extent = board_extent(views)
    squares = np.zeros(len(views))
    sigma = max(float(np.sqrt(fit.variance)), 1e-3)
    for fold in range(folds):
        out = np.arange(len(views)) % folds == fold
        inside = [view for view, held in zip(views, out, strict=True) if not held]
        others = [view for view, held in zip(views, out, strict=True) if held]
        trained = adjust(
            inside, fit.lens, fit.theta, fit.poses[~out],
            warp=fit.warp, flat=flat, sigma_px=sigma, iterations=25, extent=extent,
        )  # fmt: skip
        tested = adjust(
            others, fit.lens, trained.theta, fit.poses[out], warp=trained.warp, fixed=True, iterations=25, extent=extent
        )
        for index, residual in zip(np.nonzero(out)[0], tested.residuals, strict=True):
            count = len(residual)
            squares[index] = (residual**2).sum() / count * (2 * count / max(2 * count - 6, 1))
        tick()
    return HeldOut(squares, np.array([len(view.ids) for view in views], dtype=np.int64))
