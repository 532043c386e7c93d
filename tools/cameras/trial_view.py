"""What a trial of a camera found, in words."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from common.quality.depth_holes import punched
from tools.cameras.measure import Measured

_SLOW = 0.9
"""Below this share of the rate that was asked for it is said."""
_EXPOSURES = {
    "good": "well exposed",
    "dark": "too dark: more than half of the picture is black; longer exposure, more light or more gain",
    "bright": "too bright: parts are burnt out, markers there are lost; shorter exposure or less gain",
    "contrast": "black and burnt-out parts at once; light the scene more evenly",
}


def trial_view(measured: Measured, holder: str | None) -> RenderableType:
    """Sentences on what is wrong first, then a table."""
    lines = [f"through the running stack, whose {holder} holds the camera"] if holder else []
    return Group(*(Text(line) for line in lines), *_warnings(measured), _table(measured))


def _warnings(measured: Measured) -> list[Text]:
    lines = [measured.last_error] if measured.last_error else []
    if not measured.frames:
        lines.append(f"no picture came from {measured.name}; it is {measured.phase}")
    elif measured.fps is not None and measured.fps < _SLOW * measured.nominal_fps:
        lines.append(
            f"{measured.fps:.1f} frames/s instead of {measured.nominal_fps:g}: a dark scene (long exposure), a slow "
            "USB port or a busy machine"
        )
    if measured.exposure not in (None, "good"):
        lines.append(_EXPOSURES[str(measured.exposure)])
    on, around = measured.depth_on_markers, measured.depth_around_markers
    if on is not None and around is not None and punched(on, around):
        lines.append(
            f"the markers punch holes into the depth: {on:.0%} of their pixels have any, {around:.0%} around them; "
            "their black ink eats infrared: print them with another ink or printer, or on matt paper"
        )
    lines += measured.warnings
    return [Text(f"! {line}", style="yellow") for line in lines]


def _table(measured: Measured) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for row in _rows(measured):
        table.add_row(*row)
    return table


def _rows(now: Measured) -> list[tuple[str, str]]:
    serial = f", serial {now.serial}" if now.serial else ""
    rows = [
        (now.name, f"{now.driver}{serial}, {now.phase}"),
        ("picture", f"{now.size[0]}x{now.size[1]}, intrinsics: {now.intrinsics_from}"),
    ]
    if now.fps is not None:
        rows.append(("rate", f"{now.fps:.2f} frames/s over {now.seconds:.1f} s ({now.nominal_fps:g} asked for)"))
        spread = f"p50 {now.interval_p50_ms:.1f} ms, p95 {now.interval_p95_ms:.1f} ms"
        rows.append(("interval", f"{spread}, longest {now.interval_longest_ms:.1f} ms"))
    elif now.frames:
        rows.append(("rate", "shows its first picture and waits for a recording"))
    lost = ", ".join(f"{why} {count}" for why, count in sorted(now.lost.items()))
    rows.append(("lost", f"{lost or 'none'} in the camera, {now.not_heard} on the way here"))
    if now.exposure is not None:
        words = _EXPOSURES[now.exposure].partition(":")[0]
        ends = f"black {now.dark_share:.1%}, burnt out {now.bright_share:.1%}"
        rows.append(("exposure", f"{words}; mean {now.brightness:.0f} of 255, {ends}"))
    if now.depth_unit_mm is None:
        rows.append(("depth", "none"))
    elif now.depth_valid is not None:
        rows.append(("depth", f"{now.depth_valid:.0%} of the pixels, median {now.depth_median_mm:.0f} mm"))
    seen = ", ".join(f"{marker} ({count} of {now.looked_at})" for marker, count in sorted(now.markers.items()))
    rows.append(("markers", seen or "none seen"))
    if now.snapshot:
        rows.append(("snapshot", now.snapshot))
    return rows
