"""CPU and memory of processes with their worker processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil

from common import clock

_SATURATED = 0.95
"""A core this busy between two looks has no time left."""


@dataclass(frozen=True)
class Usage:
    """Over a time: CPU in percent of one core, and memory (MB, unique set) at its end; workers included."""

    cpu_percent: float
    memory_mb: float
    processes: int


@dataclass(frozen=True)
class Busy:
    """The machine over a time: percent of all cores and of the busiest one, looks at which one was saturated."""

    percent: float
    busiest_percent: float
    saturated: int
    looks: int


@dataclass(frozen=True)
class Snapshot:
    """Where a service's processes stood."""

    at_ns: int
    cpu_s: dict[int, float]
    memory_bytes: int


def usage_now(pids: Mapping[str, int]) -> dict[str, Snapshot]:
    """A snapshot of each named process and its children."""
    return {name: _snapshot(pid) for name, pid in pids.items()}


def usage_between(before: Mapping[str, Snapshot], after: Mapping[str, Snapshot]) -> dict[str, Usage]:
    """What was used between two snapshots; a process that came later counts from its start."""
    usages = {}
    for name, end in after.items():
        begin = before.get(name)
        if begin is None:
            continue
        spent = sum(seconds - begin.cpu_s.get(pid, 0.0) for pid, seconds in end.cpu_s.items())
        elapsed = max((end.at_ns - begin.at_ns) / 1e9, 1e-9)
        usages[name] = Usage(round(100 * spent / elapsed, 1), round(end.memory_bytes / 1e6, 1), len(end.cpu_s))
    return usages


class Cores:
    """How busy the machine's cores are, all that runs on it included; ``look`` about once a second."""

    def __init__(self) -> None:
        self._before = psutil.cpu_times(percpu=True)
        self._shares: list[list[float]] = []

    def look(self) -> None:
        """Take note of the time since the last look."""
        now = psutil.cpu_times(percpu=True)
        self._shares.append([_busy(one, two) for one, two in zip(self._before, now, strict=True)])
        self._before = now

    def result(self) -> Busy:
        """Over all looks."""
        if not self._shares:
            return Busy(0.0, 0.0, 0, 0)
        by_core = np.array(self._shares)
        saturated = int((by_core.max(axis=1) >= _SATURATED).sum())
        mean = by_core.mean(axis=0)
        return Busy(round(100 * float(mean.mean()), 1), round(100 * float(mean.max()), 1), saturated, len(self._shares))


def _busy(before: Any, after: Any) -> float:
    """The share of a core's time in which it worked (psutil's ``scputimes``; waiting for the disk is none)."""
    spent = {name: getattr(after, name) - getattr(before, name) for name in after._fields if "guest" not in name}
    whole = sum(spent.values())
    idle = spent["idle"] + spent.get("iowait", 0.0)
    return 1 - idle / whole if whole > 0 else 0.0


def _snapshot(pid: int) -> Snapshot:
    cpu: dict[int, float] = {}
    memory = 0
    try:
        parent = psutil.Process(pid)
        family = [parent, *parent.children(recursive=True)]
    except psutil.NoSuchProcess:
        family = []
    for process in family:
        try:
            times = process.cpu_times()
            memory += process.memory_full_info().uss
        except psutil.NoSuchProcess:
            continue
        cpu[process.pid] = times.user + times.system
    return Snapshot(clock.monotonic_ns(), cpu, memory)
