"""What `bench stall` found, and how it says so."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console

from tools.bench.capture_times import Captured
from tools.bench.stall_watch import Phase
from tools.report.table import print_table


@dataclass
class Stalled:
    """The whole run.

    ``ledgers`` by camera, of the recording; ``orders`` by their outcome; ``complaints``: what must not be, a sentence
    each, but for frames that a camera dropped, which ``cameras`` says.
    """

    phases: dict[str, Phase]
    cameras: dict[str, Captured]
    ledgers: dict[str, Any] = field(default_factory=dict)
    orders: dict[str, int] = field(default_factory=dict)
    acknowledged: int = 0
    on_disk: int = 0
    complaints: list[str] = field(default_factory=list)

    @property
    def found(self) -> list[str]:
        """Everything that must not be."""
        drops = [
            f"{name} dropped {sum(one.dropped.values())} of {one.offered} frames ({', '.join(one.dropped)})"
            for name, one in self.cameras.items()
            if one.dropped
        ]
        return drops + self.complaints


def print_stall(stalled: Stalled) -> None:
    """Three tables and what is wrong."""
    console = Console(highlight=False)
    _print_frames(console, stalled)
    _print_phases(console, stalled)
    _print_ledgers(console, stalled)
    orders = ", ".join(f"{what} {count}" for what, count in sorted(stalled.orders.items())) or "none"
    print(f"Record orders meanwhile: {orders}")
    print(f"{stalled.acknowledged} samples acknowledged to them; {stalled.on_disk} on the disk, each read back")
    for line in stalled.found or ["no camera dropped a frame, and everything is accounted for"]:
        print(line)


def _print_frames(console: Console, stalled: Stalled) -> None:
    rows = [
        [name, *(str(count) for count in (one.offered, one.captured, sum(one.dropped.values()), one.unheard))]
        for name, one in stalled.cameras.items()
    ]
    title = "Frames, from the first phase to the last"
    print_table(console, title, ("camera", "offered", "captured", "dropped", "news missed"), rows)


def _print_phases(console: Console, stalled: Stalled) -> None:
    """How even the captures were, and beside it what the machine had to do; each p99 against the first phase's."""
    first = next(iter(stalled.phases.values()))
    evenness, machine = [], []
    for what, phase in stalled.phases.items():
        for name, one in phase.jitter.items():
            more = "-" if phase is first else f"{one.p99_ms - first.jitter[name].p99_ms:+.2f}"
            evenness.append([f"{what}: {name}", f"{one.p50_ms:.2f}", f"{one.p99_ms:.2f}", more, f"{one.max_ms:.2f}"])
        busy, own = phase.machine, sum(usage.cpu_percent for usage in phase.processes.values())
        seconds = f"{busy.saturated} of {busy.looks}"
        machine.append([what, f"{own:.0f}", f"{busy.percent:.0f}", f"{busy.busiest_percent:.0f}", seconds])
    title = "Jitter: the time between two captures against the period, ms"
    print_table(console, title, ("phase: camera", "p50", "p99", "p99 over the first", "max"), evenness)
    columns = ("phase", "the stack", "all cores", "the busiest", "s with a saturated one")
    print_table(console, "CPU, % (the stack: of one core; cores: with all else that runs)", columns, machine)


def _print_ledgers(console: Console, stalled: Stalled) -> None:
    rows = [
        [name, str(one["captured"]), str(one["recorded"]), _by_reason(one["refused"]), _by_reason(one["dropped"])]
        for name, one in stalled.ledgers.items()
    ]
    columns = ("camera", "captured", "recorded", "refused", "dropped at")
    print_table(console, "The recording's ledger, frames", columns, rows)


def _by_reason(counts: dict[str, int]) -> str:
    return ", ".join(f"{why} {count}" for why, count in Counter(counts).most_common()) or "-"
