"""The load test's figures for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from tools.bench.load import Load


def print_load(load: Load, options: Mapping[str, Any]) -> None:
    """Two tables: frames by camera, cost by process; and what the record orders were answered."""
    console = Console(highlight=False)
    asked = f"{options['cameras']} cameras of {options['size']} at {options['fps']:g}/s, {load.seconds:.1f} s"
    slow = f", labelling slowed by {options['label_delay_ms']:g} ms a frame" if options["label_delay_ms"] else ""
    frames = Table(title=f"Frames: {asked}{slow}")
    for heading in ("camera", "offered", "captured", "detected", "labelled", "skipped (where: why)", "overruns"):
        frames.add_column(heading, justify="right")
    frames.add_column("capture → label p50 / p99 ms", justify="right")
    for name, camera in load.cameras.items():
        skipped = ", ".join(f"{where} {count}" for where, count in sorted(camera.skipped.items())) or "-"
        late = "-" if camera.latency_p50_ms is None else f"{camera.latency_p50_ms:.1f} / {camera.latency_p99_ms:.1f}"
        frames.add_row(
            name,
            str(camera.offered),
            f"{camera.captured} ({camera.captured / max(camera.offered, 1):.1%})",
            str(camera.detected),
            str(camera.labelled),
            skipped,
            str(camera.ring_overruns),
            late,
        )
    console.print(frames)
    cost = Table(title="Processes, their workers included")
    for heading in ("process", "CPU % of a core", "memory MB", "processes"):
        cost.add_column(heading, justify="right")
    for name, usage in load.processes.items():
        cost.add_row(name, f"{usage.cpu_percent:.1f}", f"{usage.memory_mb:.0f}", str(usage.processes))
    total = sum(usage.cpu_percent for usage in load.processes.values())
    cost.add_row("together", f"{total:.1f}", "", "")
    console.print(cost)
    if load.records:
        answers = ", ".join(f"{what} {count}" for what, count in sorted(load.records.items()))
        console.print(f"Record orders while the store stood still and after: {answers}")
