"""CPU and memory of processes with their worker processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import psutil

from common import clock


@dataclass(frozen=True)
class Usage:
    """Over a time: CPU in percent of one core, and memory (MB, unique set) at its end; workers included."""

    cpu_percent: float
    memory_mb: float
    processes: int


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
