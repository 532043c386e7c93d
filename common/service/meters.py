"""Numbers a service keeps about itself. Pure: the caller may give the time."""

from __future__ import annotations

import math
from collections import deque

from common import clock


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
