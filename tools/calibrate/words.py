"""What the command says, on one screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from common.calibration import Miss, Outcome, Solution, wishes
from common.calibration.candidates import Candidate

_SHOWN = 6


def said(outcome: Outcome, misses: Sequence[Miss], told: Sequence[str]) -> list[str]:
    """Verdict first, then figures, then what was left out and why."""
    lines = [outcome.verdict.level.upper()]
    lines += [f"  - {reason.words}" for reason in outcome.verdict.reasons]
    if outcome.solution is not None:
        lines += _figures(outcome.solution)
    lines += _left_out(outcome, misses)
    if outcome.verdict.level != "good" and outcome.spread.stances:
        lines += [f"next: {wish.words}" for wish in wishes(outcome.spread)[:2]]
    return [*lines, *(f"note: {text}" for text in told)]


def _figures(solution: Solution) -> list[str]:
    fit, chosen, sd = solution.fit, solution.chosen, solution.uncertainty.sd
    values = zip(chosen.lens.parameters, fit.theta, sd, strict=False)
    core = ", ".join(f"{name} {value:.2f} +- {spread:.2f}" for name, value, spread in list(values)[:4])
    held = "" if chosen.held_out is None else f", held out {chosen.held_out.rms:.3f} px"
    tilts = f"tilts spanning {solution.spread.tilt_range_deg:.0f} degrees"
    lines = [
        f"lens: {chosen.words}",
        f"      {core}",
        f"fit:  rms {fit.rms:.3f} px{held}; {len(solution.views)} views, {fit.count} corners",
        f"      {solution.spread.covered:.0%} of the picture covered, {tilts}",
        f"sure: distances to {100 * solution.focal_share:.2f} %; {_projection(solution)}",
    ]
    if solution.warp_mm:
        lines.append(f"board: bent by {solution.warp_mm:.2f} mm (allowed for)")
    return lines + [f"  or: {_other(one)}" for one in solution.candidates if one is not chosen]


def _projection(solution: Solution) -> str:
    found = solution.map
    where = f"{found.centre_px:.2f} px in the middle, {found.worst_px:.2f} px at the {found.worst_place}"
    return f"a projection {found.distance_mm:.0f} mm away to {where}"


def _other(one: Candidate) -> str:
    fault = f"; {one.fault}" if one.fault else ""
    return f"{one.words}: fx {one.fit.theta[0]:.1f}, held out {one.score:.3f} px{fault}"


def _left_out(outcome: Outcome, misses: Sequence[Miss]) -> list[str]:
    lines = [f"left out: {item.name}: {item.reason}" for item in outcome.dropped if item.code == "outlier"]
    for code, what in (("repeated", "repeat another view"), ("surplus", "were not needed")):
        names = [item.name for item in outcome.dropped if item.code == code]
        if names:
            lines.append(f"left out: {_some(names)} {what}")
    if outcome.solution is not None:
        corners = outcome.solution.dropped_corners
        lines += [f"left out: {count} corners of {name}, misplaced" for name, count in corners.items()]
        lines += [f"{view.name}: {note}" for view in outcome.solution.views for note in view.notes][:_SHOWN]
    for reason, count in Counter(miss.reason for miss in misses).most_common(3):
        names = [miss.name for miss in misses if miss.reason == reason]
        lines.append(f"no view: {_some(names)} ({count}): {reason}")
    return lines


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
