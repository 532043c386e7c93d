"""A distance that somebody measured, against the calibration's: the only thing that shows a wrong square size."""

from __future__ import annotations

import re

from common.calibration import Reason, Solution
from common.calibration.verdict import MUCH_SCALE
from common.errors import RefusedError

HONEST = (
    "A wrong square size can't be seen in pictures: it leaves the intrinsics as they are and scales every distance. "
    "Measure the camera's distance to the board's middle in one view and give --measured NAME=MM."
)


def parse_measured(text: str) -> tuple[str, float]:
    """``left01.jpg=612`` as name and mm. Raises RefusedError."""
    match = re.fullmatch(r"(.+)=(\d+(?:\.\d+)?)", text)
    if match is None or float(match[2]) <= 0:
        raise RefusedError(f"--measured must be NAME=MM, a picture and a distance, not {text!r}", code="bad_request")
    return match[1], float(match[2])


def judge_measured(solution: Solution, name: str, measured_mm: float) -> tuple[str, list[Reason]]:
    """What comes of the comparison in words, and a reason against the calibration if they differ by too much.

    Raises RefusedError where the view isn't among those used.
    """
    stances = {view.name: one for view, one in zip(solution.views, solution.spread.stances, strict=True)}
    if name not in stances:
        raise RefusedError(f"--measured: {name} is not among the views that were used", code="no_view")
    found = stances[name].distance_mm
    ratio = measured_mm / found
    words = f"in {name} the board stood at {measured_mm:.0f} mm as measured, at {found:.0f} mm by the calibration"
    if abs(ratio - 1) <= max(MUCH_SCALE, 3 * solution.focal_share):
        return words, []
    advice = f"the board's sizes are {ratio:.3f} times what was given, or the measurement is wrong"
    return words, [Reason("wrong_size", "not yet", f"{words}: {advice}")]
