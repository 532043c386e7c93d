"""The load test's figures for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from tools.bench.load import Load
    from tools.bench.load_counter import CameraLoad


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
    if load.hops:
        console.print(_hops(load))
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
        console.print(f"Recorded meanwhile: {answers}")


def _hops(load: Load) -> Table:
    table = Table(title="Where the time goes, ms a frame, all cameras")
    for heading in ("hop", "p50", "p99", "mean", "mean of the slowest 1 %"):
        table.add_column(heading, justify="right")
    for name, hop in load.hops.items():
        values = (hop.p50_ms, hop.p99_ms, hop.mean_ms, hop.slowest_mean_ms)
        table.add_row(name, *(f"{value:.2f}" for value in values))
    means = [sum(values) for values in zip(*((h.mean_ms, h.slowest_mean_ms) for h in load.hops.values()), strict=True)]
    table.add_row("together", "", "", *(f"{value:.2f}" for value in means))
    return table


_KEPT_UP = 0.95


def print_growth(loads: Mapping[int, Load]) -> None:
    """How cost and latency grow with the cameras, and from how many on the machine no longer keeps up."""
    console = Console(highlight=False)
    table = Table(title="Growth: all cameras together")
    for heading in ("cameras", "captured", "labelled", "p50 / p99 ms, the slowest camera", "CPU %", "CPU % a camera"):
        table.add_column(heading, justify="right")
    for count, load in loads.items():
        cameras = load.cameras.values()
        captured, labelled = (_share(load, what) for what in ("captured", "labelled"))
        cpu = sum(usage.cpu_percent for usage in load.processes.values())
        p50, p99 = (max(_late(camera, which) for camera in cameras) for which in (50, 99))
        table.add_row(
            str(count),
            f"{captured:.1%}",
            f"{labelled:.1%}",
            f"{p50:.1f} / {p99:.1f}",
            f"{cpu:.0f}",
            f"{cpu / count:.0f}",
        )
    console.print(table)
    late = [
        count for count, load in loads.items() if min(_share(load, "captured"), _share(load, "labelled")) < _KEPT_UP
    ]
    if late:
        what = "captures" if _share(loads[min(late)], "captured") < _KEPT_UP else "labels"
        console.print(
            f"Saturated at {min(late)} cameras: the stack {what} less than {_KEPT_UP:.0%} of the frames offered"
        )
    else:
        console.print(f"Not saturated: of every camera at least {_KEPT_UP:.0%} of the frames were labelled")


def _share(load: Load, what: str) -> float:
    """The least share of any camera's offered frames. A frame under way at either end may make it pass 1."""
    return float(min(getattr(camera, what) / max(camera.offered, 1) for camera in load.cameras.values()))


def _late(camera: CameraLoad, which: int) -> float:
    late = camera.latency_p50_ms if which == 50 else camera.latency_p99_ms
    return float("nan") if late is None else late
