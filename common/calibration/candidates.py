"""Which lens model the views call for: each is fitted and judged by views that were held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted, adjust
from common.calibration.hold_out import FOLDS, LEAST_VIEWS, HeldOut, hold_out
from common.calibration.lens import LENSES, Lens
from common.calibration.start import first_guess, pose_of
from common.calibration.views import View

Array = NDArray[np.float64]
_GAIN = {"2": 1.0, "5": 1.0, "8": 0.9975, "fisheye": 0.985}
"""A model is taken if its held-out rms is below this share of the best so far. The rational and the fisheye model
must earn it: outside of what the views cover they may bend as they like, or are not what most software expects."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted model. ``held_out``: None with too few views; ``fault``: why it can't be taken, '' if it can."""

    lens: Lens
    flat: bool
    fit: Adjusted
    held_out: HeldOut | None
    fault: str = ""

    @property
    def words(self) -> str:
        """The model for people."""
        return self.lens.words + ("" if self.flat else ", board warped")

    @property
    def score(self) -> float:
        """What it is judged by, px: held-out rms, or that of the fit where nothing could be held out."""
        return self.fit.rms if self.held_out is None else self.held_out.rms


def steps(models: Sequence[str]) -> int:
    """How often ``compare`` will call its ``tick``."""
    return 2 * len(models) * FOLDS


def compare(
    views: Sequence[View], models: Sequence[str], start: Adjusted, *, tick: Callable[[], None] = lambda: None
) -> tuple[Candidate, ...]:
    """Fit each of the models, with a flat and with a warped board, and hold views out. ``tick`` after each fold."""
    found: list[Candidate] = []
    last: Adjusted = start
    for name in models:
        lens = LENSES[name]
        if lens.fisheye and not last.lens.fisheye:
            plain, theta = first_guess(views, fisheye=True)
            theta = lens.from_other(plain, theta)
            camera = lens.camera(theta, views[0].size)
            poses = np.array([pose_of(view, camera) for view in views])
        else:
            theta, poses = lens.from_other(last.lens, last.theta), last.poses
        flat = settled(views, lens, theta, poses, flat=True)
        warped = settled(views, lens, flat.theta, flat.poses, flat=False)
        last = flat
        found += [_judged(views, lens, fit, flat=fit is flat, tick=tick) for fit in (flat, warped)]
    return tuple(found)


def settled(views: Sequence[View], lens: Lens, theta: Array, poses: Array, *, flat: bool) -> Adjusted:
    """The fit with its priors weighed by its own residuals."""
    rough = adjust(views, lens, theta, poses, flat=flat)
    sigma = max(float(np.sqrt(rough.variance)), 1e-3)
    return adjust(views, lens, rough.theta, rough.poses, warp=rough.warp, flat=flat, sigma_px=sigma)


def best(candidates: Sequence[Candidate]) -> Candidate:
    """The one that predicts held-out views best, the simpler one in doubt."""
    sound = [candidate for candidate in candidates if not candidate.fault] or list(candidates)
    chosen: Candidate | None = None
    for name in LENSES:
        for candidate in sound:
            if candidate.lens.name != name:
                continue
            if chosen is None or candidate.score < chosen.score * (
                1.0 if chosen.lens is candidate.lens else _GAIN[name]
            ):
                chosen = candidate
    assert chosen is not None, "compare() was given no model"
    return chosen


def _judged(views: Sequence[View], lens: Lens, fit: Adjusted, *, flat: bool, tick: Callable[[], None]) -> Candidate:
    held = None
    if len(views) >= LEAST_VIEWS:
        held = hold_out(views, fit, flat=flat, tick=tick)
    return Candidate(lens, flat, fit, held, _fault(views, fit))


def _fault(views: Sequence[View], fit: Adjusted) -> str:
    """Whether the model makes sense where the views are, and in the whole picture."""
    fx, fy = fit.theta[:2]
    width, height = views[0].size
    if not np.isfinite(fit.theta).all() or min(fx, fy) <= 0:
        return "has no positive focal length"
    if not 0.8 < fx / fy < 1.25:
        return f"has fx {fx:.0f} but fy {fy:.0f}, which no lens has"
    if not (0 <= fit.theta[2] < width and 0 <= fit.theta[3] < height):
        return "has its centre outside the picture"
    camera = fit.lens.camera(fit.theta, (width, height))
    rim = np.concatenate([_rim(width, height, 24), np.concatenate([view.corners for view in views])])
    lost = ~np.isfinite(camera.normalise(rim)).all(axis=1)
    return f"folds back inside the picture ({lost.mean():.0%} of its rim have no ray)" if lost.any() else ""


def _rim(width: int, height: int, count: int) -> Array:
    x, y = np.linspace(0, width - 1, count), np.linspace(0, height - 1, count)
    sides = [(x, 0 * x), (x, 0 * x + height - 1), (0 * y, y), (0 * y + width - 1, y)]
    return np.concatenate([np.column_stack(side) for side in sides])
