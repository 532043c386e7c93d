"""The recording benchmark for people."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from tools.bench.record_steps import STEPS
from tools.report.table import print_table

if TYPE_CHECKING:
    from tools.bench.record import Recorded, Result

_CONSOLE = Console(highlight=False)
_SCRIPT_STEPS = {"refine, pose": "pose", "write, fsync": "write"}


def print_disk(root: Path, needed: int, free: int) -> None:
    """What it will take, before it begins."""
    _CONSOLE.print(
        f"Records into {root.absolute()}, removed afterwards: up to {needed / 1e9:.1f} of {free / 1e9:.1f} GB free",
        soft_wrap=True,
    )


def print_record(result: Result, seconds: float) -> None:
    """All of it."""
    if result.camera is not None:
        _recording(f"A camera of 30 frames/s, 1280x720 RGB-D, {seconds:g} s", [result.camera])
    if result.fastest and result.script is not None and result.ratios:
        _recording("As fast as the stack takes it", result.fastest)
        rates = result.script.samples_per_s
        _CONSOLE.print(
            f"The plain script on the same frames, in turn: {statistics.mean(rates):.1f} samples/s "
            f"({min(rates):.1f} to {max(rates):.1f}), {result.script.megabytes_per_s:.0f} MB/s, nothing synced\n"
            f"Ratio: {statistics.median(result.ratios):.2f} ({min(result.ratios):.2f} to {max(result.ratios):.2f})",
            soft_wrap=True,
        )
    _steps(result)
    _services(result)
    _CONSOLE.print(f"Fill: {result.fill}, the script's: {result.script_fill}. Pictures: {result.picture_format}")


def _recording(title: str, rows: list[Recorded]) -> None:
    _CONSOLE.print()
    print_table(
        _CONSOLE,
        title,
        ("", "captured", "recorded", "not recorded", "samples a second", "MB/s", "CPU % of a core"),
        [
            [
                f"turn {number}" if len(rows) > 1 else "",
                str(row.captured),
                str(row.recorded),
                _lost(row),
                f"{row.samples_per_s:.1f}",
                f"{row.megabytes_per_s:.0f}",
                f"{sum(usage.cpu_percent for usage in row.processes.values()):.0f}",
            ]
            for number, row in enumerate(rows, 1)
        ],
    )
    usage = ", ".join(f"{name} {use.cpu_percent:.0f}" for name, use in rows[-1].processes.items())
    _CONSOLE.print(
        f"CPU by service, its workers included: {usage}; {rows[-1].checked} samples read back", soft_wrap=True
    )


def _lost(row: Recorded) -> str:
    lost = [f"refused {why} {count}" for why, count in sorted(row.refused.items())]
    lost += [f"dropped at {where} {count}" for where, count in sorted(row.dropped.items())]
    return ", ".join(lost) or "0"


def _steps(result: Result) -> None:
    fastest = result.fastest[-1].steps_ms if result.fastest else {}
    camera = result.camera.steps_ms if result.camera else {}
    script = result.script.steps_ms if result.script else {}

    def figure(steps: Mapping[str, float], name: str) -> str:
        return f"{steps[name]:.1f}" if name in steps else "-"

    _CONSOLE.print()
    print_table(
        _CONSOLE,
        "Milliseconds a sample (clock; CPU)",
        ("step", "camera", "CPU", "fastest", "CPU", "script"),
        [
            [
                step,
                figure(camera, step),
                figure(camera, f"{step} CPU"),
                figure(fastest, step),
                figure(fastest, f"{step} CPU"),
                figure(script, _SCRIPT_STEPS.get(step, step)),
            ]
            for step in STEPS
        ],
    )


def _services(result: Result) -> None:
    """What all processes took, the steps and what is around them."""
    measured = [item.cpu_ms() for item in (result.camera, *(result.fastest or [])[-1:]) if item is not None]
    titles = ["camera"] * (result.camera is not None) + ["fastest"] * bool(result.fastest)
    if not measured:
        return
    rows = [[name, *(f"{cpu[name]:.1f}" for cpu in measured)] for name in measured[0]]
    rows.append(["all", *(f"{sum(cpu.values()):.1f}" for cpu in measured)])
    _CONSOLE.print()
    print_table(_CONSOLE, "CPU ms a sample", ("service, with its workers", *titles), rows)
