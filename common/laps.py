"""What the steps of a piece of work take: measured where it is done, summed up where it is reported. Pure data."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping

from common import clock

Laps = dict[str, tuple[float, float]]
"""By step: wall clock and CPU time (ms)."""


class Stopwatch:
    """What the steps of one piece of work take, on the thread that makes it; plain data in ``laps``."""

    def __init__(self) -> None:
        self.laps: Laps = {}
        self._wall, self._cpu = clock.monotonic_ns(), time.thread_time_ns()

    def lap(self, step: str) -> None:
        """What was done since the last lap was ``step``; a step that comes again adds up."""
        wall, cpu = clock.monotonic_ns(), time.thread_time_ns()
        known = self.laps.get(step, (0.0, 0.0))
        self.laps[step] = (known[0] + (wall - self._wall) / 1e6, known[1] + (cpu - self._cpu) / 1e6)
        self._wall, self._cpu = wall, cpu


class StepMeans:
    """The mean laps of the newest ``size`` pieces of work."""

    def __init__(self, size: int = 256) -> None:
        self._newest: deque[Mapping[str, tuple[float, float]]] = deque()
        self._size = size
        self._sums: dict[str, float] = {}  # kept up: who reports several times a second doesn't go through all of them

    def add(self, laps: Mapping[str, tuple[float, float]]) -> None:
        """One piece of work was done."""
        if laps:
            self._newest.append(laps)
            self._count(laps, 1)
            if len(self._newest) > self._size:
                self._count(self._newest.popleft(), -1)

    def as_numbers(self) -> dict[str, float]:
        """``<step>_ms`` and ``<step>_cpu_ms`` of each step, for a report; empty before the first."""
        count = len(self._newest)
        return {name: total / count for name, total in self._sums.items()}

    def _count(self, laps: Mapping[str, tuple[float, float]], sign: int) -> None:
        sums = self._sums
        for step, (wall, cpu) in laps.items():
            sums[f"{step}_ms"] = sums.get(f"{step}_ms", 0.0) + sign * wall
            sums[f"{step}_cpu_ms"] = sums.get(f"{step}_cpu_ms", 0.0) + sign * cpu
