"""Is a calibration good, usable, or not there yet, and why: rules with their figures, never a low rms alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from common.calibration.detect import BLURRED_PX
from common.calibration.diversity import GRID, Spread
from common.calibration.views import View

Level = Literal["good", "usable", "not yet"]
ORDER: tuple[Level, ...] = ("good", "usable", "not yet")

LEAST_VIEWS, GOOD_VIEWS = 6, 10
LEAST_TILT_DEG, GOOD_TILT_DEG = 15.0, 25.0
LEAST_TILT_RANGE_DEG, GOOD_TILT_RANGE_DEG = 20.0, 35.0
LEAST_COVERED, GOOD_COVERED = 0.35, 0.6
MOST_FOCAL_SHARE, GOOD_FOCAL_SHARE = 0.01, 0.003
"""Standard deviation of fx as a share of it, which is what distances will be off by."""
MOST_HELD_OUT, GOOD_HELD_OUT = 2.0, 0.7
"""Held-out rms in thousandths of the picture's diagonal."""
GOOD_PROJECTION = 3.0
"""Uncertainty of projection anywhere in the picture, in the same thousandths."""
GOOD_WARP = 0.005
"""Deflection of the board as a share of its longer side."""
MUCH_SCALE = 0.03
"""A measured distance may differ by this share from the calibration's, or by three standard deviations."""


@dataclass(frozen=True)
class Reason:
    """Why a calibration is not better than ``level``. ``code`` for programs, ``words`` what and what to do."""

    code: str
    level: Level
    words: str


@dataclass(frozen=True)
class Verdict:
    """``reasons``: those of the worst level first; none means good."""

    reasons: tuple[Reason, ...]

    @property
    def level(self) -> Level:
        """The worst of the reasons' levels."""
        return max((reason.level for reason in self.reasons), key=ORDER.index, default="good")

    @property
    def sentence(self) -> str:
        """`good`, or the level with its reasons."""
        because = "; ".join(reason.words for reason in self.reasons if reason.level == self.level)
        return f"{self.level}, because {because}" if because else self.level


def verdict(*reasons: Sequence[Reason]) -> Verdict:
    """From the reasons of several judges, worst first."""
    flat = [reason for some in reasons for reason in some]
    return Verdict(tuple(sorted(flat, key=lambda reason: -ORDER.index(reason.level))))


def judge_views(views: Sequence[View], distinct: int, spread: Spread) -> list[Reason]:
    """What can be said of views before or without a fit: too few, too alike, badly spread, blurred."""
    reasons: list[Reason] = []
    if len(views) >= 3 and distinct <= len(views) // 3 and distinct < GOOD_VIEWS:
        words = f"{len(views) - distinct} of {len(views)} views only repeat another: move the board between them"
        reasons.append(Reason("repeated", "not yet", words))
    elif distinct < LEAST_VIEWS:
        reasons.append(
            Reason("few", "not yet", f"there are only {distinct} different views; take {GOOD_VIEWS} or more")
        )
    elif distinct < GOOD_VIEWS:
        reasons.append(Reason("few", "usable", f"there are only {distinct} different views; take {GOOD_VIEWS} or more"))
    return [*reasons, *_tilts(spread), *_coverage(spread), *_blur(views)]


def _tilts(spread: Spread) -> list[Reason]:
    tilts = [stance.tilt_deg for stance in spread.stances]
    if not tilts:
        return []
    low, high = round(min(tilts)), round(max(tilts))
    span = f"{high} degrees" if low == high else f"{low} to {high} degrees"
    distance = f" and the same distance ({_mean_distance(spread):.0f} mm)" if spread.distance_ratio < 1.15 else ""
    cure = "tilt it by 30 to 45 degrees to the left, right, top and bottom"
    if spread.tilt_range_deg < LEAST_TILT_RANGE_DEG:
        if max(tilts) < LEAST_TILT_DEG and min(tilts) < 6:
            words = (
                f"all views look straight at the board (tilt {span}), so focal length and distance can't be told apart"
            )
            return [Reason("frontal", "not yet", f"{words}: {cure}")]
        return [Reason("same_tilt", "not yet", f"every view has the same tilt ({span}){distance}: {cure}")]
    if max(tilts) < LEAST_TILT_DEG:
        return [Reason("frontal", "not yet", f"the board was hardly tilted (at most {max(tilts):.0f} degrees): {cure}")]
    if max(tilts) < GOOD_TILT_DEG or spread.tilt_range_deg < GOOD_TILT_RANGE_DEG:
        return [
            Reason("little_tilt", "usable", f"the board's tilts span only {spread.tilt_range_deg:.0f} degrees: {cure}")
        ]
    return []


def _mean_distance(spread: Spread) -> float:
    return float(np.mean([stance.distance_mm for stance in spread.stances]))


def _coverage(spread: Spread) -> list[Reason]:
    if not spread.stances or spread.covered >= GOOD_COVERED:
        return []
    missing = where(spread, seen=False)
    if spread.covered < LEAST_COVERED:
        words = f"the views cover only {spread.covered:.0%} of the picture ({where(spread, seen=True)})"
        return [Reason("badly_spread", "not yet", f"{words}: show the board also at its {missing}")]
    words = f"only {spread.covered:.0%} of the picture are covered: show the board also at its {missing}"
    return [Reason("badly_spread", "usable", words)]


def where(spread: Spread, *, seen: bool) -> str:
    """The part of the picture with the most covered (or bare) cells, in words."""
    columns, rows = GRID
    wanted = (spread.cells > 0) == seen
    thirds = {}
    for down, vertical in enumerate(("upper", "", "lower")):
        for across, horizontal in enumerate(("left", "", "right")):
            part = wanted[
                rows * down // 3 : rows * (down + 1) // 3, columns * across // 3 : columns * (across + 1) // 3
            ]
            thirds[" ".join(word for word in (vertical, horizontal) if word) or "middle"] = float(part.mean())
    most = max(thirds.values())
    return " and ".join([name for name, share in thirds.items() if share >= most - 1e-9][:2])


def _blur(views: Sequence[View]) -> list[Reason]:
    blurred = [view for view in views if view.edge_px > BLURRED_PX]
    if not blurred:
        return []
    width = float(np.median([view.edge_px for view in blurred]))
    words = f"{len(blurred)} of {len(views)} views are blurred (edges {width:.0f} px wide)"
    level: Level = "not yet" if 2 * len(blurred) > len(views) else "usable"
    return [Reason("blurred", level, f"{words}: hold the board still, focus, give more light")]


def judge_fit(
    *,
    diagonal_px: float,
    focal_share: float,
    held_out_px: float,
    worst_px: float,
    worst_place: str,
    warp_share: float,
    torn: bool,
) -> list[Reason]:
    """What a fit says of itself: shares of 1, and px."""
    reasons: list[Reason] = []
    if torn:
        words = "the views contradict each other: is it the right board, flat, and the camera's focus fixed?"
        reasons.append(Reason("torn", "not yet", words))
    if focal_share > GOOD_FOCAL_SHARE:
        level: Level = "not yet" if focal_share > MOST_FOCAL_SHARE else "usable"
        words = f"the focal length, and so every distance, is uncertain by {100 * focal_share:.1f} %: add tilted views"
        reasons.append(Reason("unsure_focal", level, words))
    held = 1000 * held_out_px / diagonal_px
    if not held <= GOOD_HELD_OUT:
        level = "not yet" if not held <= MOST_HELD_OUT else "usable"
        words = f"held-out views are predicted to {held_out_px:.2f} px only: is the board the right one, and flat?"
        reasons.append(Reason("bad_fit", level, words))
    if 1000 * worst_px / diagonal_px > GOOD_PROJECTION:
        words = f"at the {worst_place} of the picture a projection is uncertain by {min(worst_px, 999):.0f} px"
        words += ": show the board there"
        reasons.append(Reason("unsure_rim", "usable", words))
    if warp_share > GOOD_WARP:
        words = f"the board is bent by {100 * warp_share:.1f} % of its length: glue it to something flat"
        reasons.append(Reason("bent", "usable", words))
    return reasons
