"""From views to a calibration that says how good it is.

The whole API, pure (no file, no clock). ``BoardFinder.find`` makes a view of a picture or says why not (``Miss``);
``is_new`` and ``nearest`` tell whether it adds anything to those taken; ``spread`` and ``judge_views`` say what a set
of views is and what it lacks, before there is any fit; ``wishes`` what to show next; ``calibrate`` fits, chooses,
drops, and passes the verdict. See docs/decisions for the methods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted, board_extent
from common.calibration.candidates import Candidate, best, compare
from common.calibration.diversity import Spread, difference, distinct, most_different, spread
from common.calibration.lens import LENSES
from common.calibration.outliers import Dropped, sift
from common.calibration.start import first_guess, pose_of
from common.calibration.uncertainty import Uncertainty, UncertaintyMap, projection_map, uncertainty
from common.calibration.verdict import LEAST_VIEWS, Reason, Verdict, judge_fit, judge_views, verdict
from common.calibration.views import View
from common.geometry import CameraModel

Array = NDArray[np.float64]
MOST_VIEWS = 60
"""More views than this cost time and add next to nothing."""
_FIT_VIEWS = 3
_COPY = 0.0005
"""Views that differ by less (as a share of the diagonal) are the same picture."""
ALL_MODELS = tuple(LENSES)


@dataclass(frozen=True, eq=False)
class Solution:
    """A fitted camera and what is known of it. ``views`` are those that were used, in the order of ``fit``."""

    camera: CameraModel
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    views: tuple[View, ...]
    uncertainty: Uncertainty
    map: UncertaintyMap
    spread: Spread
    dropped_corners: dict[str, int]

    @property
    def fit(self) -> Adjusted:
        """The chosen model's adjustment."""
        return self.chosen.fit

    @property
    def focal_share(self) -> float:
        """Standard deviation of the focal length as a share of it: what distances are off by."""
        return float((self.uncertainty.sd[:2] / self.fit.theta[:2]).max())

    @property
    def warp_mm(self) -> float:
        """The board's greatest deflection, mm."""
        return float(np.abs(self.fit.warp).max())


@dataclass(frozen=True, eq=False)
class Outcome:
    """``solution`` is None where the views allow none at all; ``dropped``: views left out, with the reason."""

    verdict: Verdict
    solution: Solution | None
    dropped: tuple[Dropped, ...]
    spread: Spread


def calibrate(
    views: Sequence[View],
    *,
    models: Sequence[str] = ALL_MODELS,
    distance_mm: float | None = None,
    extra: Sequence[Reason] = (),
    tick: Callable[[], None] = lambda: None,
) -> Outcome:
    """Calibrate from views of one board.

    ``models``: names of LENSES to choose among; ``distance_mm``: where the uncertainty is mapped (None: the boards'
    median distance); ``extra``: reasons that the caller knows; ``tick`` is called after every held-out fold.
    """
    reason = _sizes(views)
    if reason is not None:
        return Outcome(verdict([reason], extra), None, (), spread([]))
    different, repeats = distinct(views)
    dropped = [_repeated(view, like) for view, like in repeats]
    used = different
    if len(different) < LEAST_VIEWS:
        # Too few to be good, but near-repeats still show what they lead to.
        used = most_different(_without_copies(views), max(LEAST_VIEWS, 24))
    if len(used) > MOST_VIEWS:
        chosen = most_different(used, MOST_VIEWS)
        names = {view.name for view in chosen}
        dropped += [
            Dropped(view.name, "surplus", "others like it are enough") for view in used if view.name not in names
        ]
        used = chosen
    used_names = {view.name for view in used}
    dropped = [item for item in dropped if item.name not in used_names]
    if len(used) < _FIT_VIEWS:
        seen = spread(used)
        return Outcome(verdict(judge_views(views, len(different), seen), extra), None, tuple(dropped), seen)
    solution, torn, outliers = _solve(used, models, distance_mm, tick)
    dropped += outliers
    # What fell out doesn't count as a view that was there.
    count = len(different) - len(outliers) if len(different) >= LEAST_VIEWS else len(different)
    looked = judge_views(solution.views if count >= LEAST_VIEWS else views, count, solution.spread)
    return Outcome(verdict(looked, _judged(solution, torn=torn), extra), solution, tuple(dropped), solution.spread)


def _solve(
    views: Sequence[View], models: Sequence[str], distance_mm: float | None, tick: Callable[[], None]
) -> tuple[Solution, bool, tuple[Dropped, ...]]:
    size = views[0].size
    only_fisheye = all(LENSES[name].fisheye for name in models)
    plain, theta = first_guess(views, fisheye=only_fisheye)
    lens = LENSES["fisheye" if only_fisheye else "5"]
    theta = lens.from_other(plain, theta)
    camera = lens.camera(theta, size)
    sifted = sift(views, lens, theta, np.array([pose_of(view, camera) for view in views]))
    candidates = compare(sifted.views, models, sifted.fit, tick=tick)
    chosen = best(candidates)
    known = uncertainty(chosen.fit)
    camera = chosen.lens.camera(chosen.fit.theta, size)
    seen = spread(sifted.views, camera, chosen.fit.poses)
    distance = distance_mm or float(np.median([stance.distance_mm for stance in seen.stances]))
    around = projection_map(chosen.fit, known, size, distance)
    solution = Solution(camera, chosen, candidates, sifted.views, known, around, seen, sifted.corners)
    return solution, sifted.torn, sifted.dropped


def _judged(solution: Solution, *, torn: bool) -> list[Reason]:
    extent = board_extent(solution.views)
    return judge_fit(
        diagonal_px=float(np.hypot(solution.camera.width, solution.camera.height)),
        focal_share=solution.focal_share,
        held_out_px=solution.chosen.score,
        worst_px=solution.map.worst_px,
        worst_place=solution.map.worst_place,
        warp_share=solution.warp_mm / float((extent[1] - extent[0]).max()),
        torn=torn,
    )


def _sizes(views: Sequence[View]) -> Reason | None:
    counts: dict[tuple[int, int], int] = {}
    for view in views:
        counts[view.size] = counts.get(view.size, 0) + 1
    if not counts:
        return Reason("no_view", "not yet", "the board was seen in no picture")
    if len(counts) == 1:
        return None
    sizes = ", ".join(f"{count} of {width}x{height}" for (width, height), count in counts.items())
    return Reason("sizes", "not yet", f"the pictures have different sizes ({sizes}): a calibration belongs to one size")


def _repeated(view: View, like: View) -> Dropped:
    return Dropped(view.name, "repeated", f"shows the board where {like.name} does")


def _without_copies(views: Sequence[View]) -> list[View]:
    kept: list[View] = []
    for view in views:
        if all(difference(view, other) >= _COPY for other in kept[-40:]):
            kept.append(view)
    return kept
