"""What `tagmill cameras test` says of what it measured."""

from __future__ import annotations

from rich.console import Console

from tools.cameras.measure import Measured
from tools.cameras.trial_view import trial_view


def told(**found: object) -> str:
    measured = Measured(
        "cam0",
        driver="realsense",
        phase="streaming",
        frames=60,
        depth_unit_mm=1.0,
        depth_valid=0.9,
        depth_median_mm=900.0,
    )
    for key, value in found.items():
        setattr(measured, key, value)
    console = Console(width=400)
    with console.capture() as captured:
        console.print(trial_view(measured, None))
    return captured.get()


def test_markers_whose_ink_costs_depth_are_warned_about() -> None:
    words = "! the markers punch holes into the depth: 12% of their pixels have any, 97% around them; their black ink"
    assert words in told(depth_on_markers=0.12, depth_around_markers=0.97)


def test_depth_that_lacks_everywhere_is_not_the_markers_fault() -> None:
    assert "punch" not in told(depth_on_markers=0.12, depth_around_markers=0.2)
    assert "punch" not in told(), "no marker was seen"
