"""The report beside a calibration: verdict, figures, models, views, maps; one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.boards import Board
from common.calibration import Miss, Outcome, Solution
from common.calibration.kept import board_words
from tools.calibrate.maps import coverage_map, projection_map, residual_map
from tools.report.page import Page
from tools.report.plot import Axis, Series, plot


def write_report(
    path: Path, camera: str, board: Board, outcome: Outcome, misses: Sequence[Miss], told: Sequence[str]
) -> None:
    """Write the page. Raises DatasetError where that can't be done."""
    page = Page(f"Calibration of {camera}: {outcome.verdict.level}")
    for reason in outcome.verdict.reasons:
        page.text(f"{reason.level}: {reason.words}.")
    if not outcome.verdict.reasons:
        page.text("Nothing speaks against it.")
    for text in told:
        page.note(text)
    page.note(f"Board: {board_words(board)}.")
    if outcome.solution is not None:
        _parameters(page, outcome.solution)
        _models(page, outcome.solution)
        _maps(page, outcome.solution)
        _views(page, outcome.solution)
    _left_out(page, outcome, misses)
    page.write(path)


def _parameters(page: Page, solution: Solution) -> None:
    fit, chosen, sd = solution.fit, solution.chosen, solution.uncertainty.sd
    page.heading("What was found")
    held = "" if chosen.held_out is None else f"; views that were held out: {chosen.held_out.rms:.3f} px"
    page.text(f"{chosen.words}; rms {fit.rms:.3f} px over {fit.count} corners of {len(solution.views)} views{held}.")
    rows = [
        [name, f"{value:.5g}" if abs(value) < 10 else f"{value:.2f}", f"{spread:.2g}", f"{_percent(value, spread)}"]
        for name, value, spread in zip(chosen.lens.parameters, fit.theta, sd, strict=False)
    ]
    page.table(["parameter", "value", "standard deviation", "of it"], rows)
    page.note(
        "Standard deviations follow from the residuals with every pose and the board's warp as unknowns, times "
        f"{np.sqrt(solution.uncertainty.design_effect):.1f} because corner errors of one picture hang together. "
        f"Distances are off by {100 * solution.focal_share:.2f} %, one standard deviation."
    )
    if solution.warp_mm:
        page.text(f"The board is bent by {solution.warp_mm:.2f} mm in its middle; that is allowed for.")


def _percent(value: float, spread: float) -> str:
    """Of the focal length and the centre; for a coefficient near 0 it says nothing."""
    return f"{100 * spread / abs(value):.2f} %" if abs(value) > 10 else ""


def _models(page: Page, solution: Solution) -> None:
    page.heading("Lens models")
    rows = []
    for one in solution.candidates:
        held = "" if one.held_out is None else f"{one.held_out.rms:.4f}"
        remark = "chosen" if one is solution.chosen else one.fault
        rows.append([one.words, f"{one.fit.rms:.4f}", held, *(f"{value:.2f}" for value in one.fit.theta[:4]), remark])
    page.table(["model", "rms, px", "held out, px", "fx", "fy", "cx", "cy", ""], rows)
    page.note(
        "Chosen is what predicts held-out views best, the simpler one in doubt. A lower rms alone means nothing: "
        "more coefficients always lower it."
    )


def _maps(page: Page, solution: Solution) -> None:
    page.heading("Over the picture")
    page.figure(coverage_map(solution))
    page.note(f"{solution.spread.covered:.0%} of the picture's 48 cells hold a corner.")
    page.figure(projection_map(solution))
    page.note(
        "How far a point of the room may be projected beside the truth. The uncertainty of intrinsics and of all board "
        "poses is propagated, the mean of the poses carrying a point (mrcal's mean-pcam method); worst direction."
    )
    page.figure(residual_map(solution))


def _views(page: Page, solution: Solution) -> None:
    fit, held = solution.fit, solution.chosen.held_out
    page.heading("Views")
    numbers = list(range(1, len(solution.views) + 1))
    series = [Series("in the fit", numbers, fit.view_rms.tolist(), line=False)]
    if held is not None:
        series.append(Series("held out", numbers, held.view_rms.tolist(), line=False))
    page.figure(plot("Rms of each view", Axis("view"), Axis("px", zero=True), series))
    rows = []
    for number, (view, stance) in enumerate(zip(solution.views, solution.spread.stances, strict=True)):
        rows.append(
            [
                f"{number + 1}. {view.name}",
                f"{len(view.ids)}",
                f"{fit.view_rms[number]:.3f}",
                "" if held is None else f"{held.view_rms[number]:.3f}",
                f"{stance.tilt_deg:.0f}",
                f"{stance.distance_mm:.0f}",
                f"{view.edge_px:.1f}",
            ]
        )
    columns = ["view", "corners", "rms, px", "held out, px", "tilt, deg", "distance, mm", "edges, px"]
    page.table(columns, rows)
    for view in solution.views:
        for note in view.notes:
            page.note(f"{view.name}: {note}.")


def _left_out(page: Page, outcome: Outcome, misses: Sequence[Miss]) -> None:
    rows = [[item.name, item.reason] for item in outcome.dropped]
    rows += [[miss.name, miss.reason] for miss in misses]
    if outcome.solution is not None:
        corners = outcome.solution.dropped_corners
        rows += [[name, f"{count} of its corners are misplaced and were left out"] for name, count in corners.items()]
    if rows:
        page.heading("Left out")
        page.table(["picture", "why"], rows)
