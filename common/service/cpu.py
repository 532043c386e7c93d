"""How much of a core a service uses, its worker processes with it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from common import clock

_TICKS = os.sysconf("SC_CLK_TCK")
_USER, _SYSTEM = 11, 12
"""Fields of /proc/PID/stat, counted behind the name, which may hold anything (proc(5): utime, stime)."""


class CpuMeter:
    """Of this process and its children (not of theirs). ``percent`` may be asked as often as one likes."""

    def __init__(self, proc: Path = Path("/proc"), least_s: float = 0.5) -> None:
        self._proc = proc
        self._least_ns = int(least_s * 1e9)
        self._percent = 0.0
        self._seen = self._used()
        self._at_ns = clock.monotonic_ns()

    def percent(self) -> float:
        """Percent of one core since the last call but those just before; a child counts from when it was seen first."""
        now = clock.monotonic_ns()
        if now - self._at_ns < self._least_ns:  # the kernel counts in hundredths of a second
            return self._percent
        used = self._used()
        spent = sum(seconds - self._seen[pid] for pid, seconds in used.items() if pid in self._seen)
        passed_s = max((now - self._at_ns) / 1e9, 1e-3)
        self._seen, self._at_ns = used, now
        self._percent = round(100.0 * max(spent, 0.0) / passed_s, 1)
        return self._percent

    def _used(self) -> dict[int, float]:
        """Seconds by process."""
        own = os.getpid()
        found: dict[int, float] = {}
        for pid in (own, *self._children(own)):
            with suppress(OSError, ValueError, IndexError):  # it has just ended
                fields = (self._proc / str(pid) / "stat").read_text().rpartition(")")[2].split()
                found[pid] = (int(fields[_USER]) + int(fields[_SYSTEM])) / _TICKS
        return found

    def _children(self, pid: int) -> list[int]:
        found: list[int] = []
        for task in (self._proc / str(pid) / "task").glob("*/children"):
            with suppress(OSError):  # a thread that has just ended
                found += [int(child) for child in task.read_text().split()]
        return found
