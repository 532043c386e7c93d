"""Numbers a service keeps about itself. Pure: the caller may give the time."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping

from common import clock

Laps = dict[str, tuple[float, float]]
"""By step: wall clock and CPU time (ms)."""


class Rate:
    """Events per second over a sliding window."""

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_ns = int(window_s * 1e9)
        self._marks: deque[tuple[int, int]] = deque()
        self._sum = 0
        self._began_ns: int | None = None

    def mark(self, count: int = 1, now_ns: int | None = None) -> None:
        """``count`` events happened now."""
        now = clock.monotonic_ns() if now_ns is None else now_ns
        if self._began_ns is None:
            self._began_ns = now
        self._marks.append((now, count))
        self._sum += count
        self._forget(now)

    def per_second(self, now_ns: int | None = None) -> float:
        """The rate over the window, or over the time since the first event while that is shorter (at least 1 s)."""
        now = clock.monotonic_ns() if now_ns is None else now_ns
        self._forget(now)
        if self._began_ns is None:
            return 0.0
        span_ns = min(self._window_ns, max(now - self._began_ns, 1_000_000_000))
        return self._sum * 1e9 / span_ns

    def _forget(self, now: int) -> None:
        while self._marks and self._marks[0][0] <= now - self._window_ns:
            self._sum -= self._marks.popleft()[1]


class Tally:
    """Counts by reason."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, reason: str, count: int = 1) -> None:
        """Count ``count`` more for ``reason``."""
        self._counts[reason] = self._counts.get(reason, 0) + count

    def __getitem__(self, reason: str) -> int:
        return self._counts.get(reason, 0)

    @property
    def total(self) -> int:
        """Over all reasons."""
        return sum(self._counts.values())

    def as_dict(self) -> dict[str, int]:
        """A copy, for a message."""
        return dict(self._counts)


class Percentiles:
    """Percentiles of the newest ``size`` values (latencies, say)."""

    def __init__(self, size: int = 1000) -> None:
        self._values: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Take one value."""
        self._values.append(value)

    def __len__(self) -> int:
        return len(self._values)

    def at(self, percent: float) -> float:
        """The value which ``percent`` of the values don't exceed (nearest rank); NaN while there is none."""
        if not self._values:
            return math.nan
        ordered = sorted(self._values)
        rank = math.ceil(percent / 100 * len(ordered))
        return ordered[min(len(ordered), max(1, rank)) - 1]


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
        self._newest: deque[Mapping[str, tuple[float, float]]] = deque(maxlen=size)

    def add(self, laps: Mapping[str, tuple[float, float]]) -> None:
        """One piece of work was done."""
        if laps:
            self._newest.append(laps)

    def as_numbers(self) -> dict[str, float]:
        """``<step>_ms`` and ``<step>_cpu_ms`` of each step, for a report; empty before the first."""
        count = len(self._newest)
        sums: dict[str, float] = {}
        for laps in self._newest:
            for step, (wall, cpu) in laps.items():
                sums[f"{step}_ms"] = sums.get(f"{step}_ms", 0.0) + wall
                sums[f"{step}_cpu_ms"] = sums.get(f"{step}_cpu_ms", 0.0) + cpu
        return {name: total / count for name, total in sums.items()}
