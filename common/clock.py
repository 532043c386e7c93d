"""The project's only clock: monotonic time orders events, wall-clock time names samples.

Nothing else calls ``time.time``; so a test can set the wall clock back here without touching the machine's.
"""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime

_wall_offset_ns = int(float(os.environ.get("TAGMILL_WALL_OFFSET_S", "0")) * 1e9)
_OFFSET_FILE = os.environ.get("TAGMILL_WALL_OFFSET_FILE")
_offset_file = None if _OFFSET_FILE is None else os.open(_OFFSET_FILE, os.O_RDONLY | os.O_CLOEXEC)
"""Seconds as text, read anew each time: sets the clock of a whole stack while it runs (`tagmill bench chaos`)."""


def monotonic_ns() -> int:
    """Nanoseconds of CLOCK_MONOTONIC; comparable between processes of one machine."""
    return time.monotonic_ns()


def wall_ns() -> int:
    """Nanoseconds since the Unix epoch (UTC); may jump when the machine's clock is set."""
    offset_ns = _wall_offset_ns
    if _offset_file is not None:
        offset_ns += int(float(os.pread(_offset_file, 32, 0) or b"0") * 1e9)
    return time.time_ns() + offset_ns


def shift_wall_clock(offset_s: float) -> None:
    """Move this process's idea of the wall clock by ``offset_s`` seconds (tests of a clock that was set)."""
    global _wall_offset_ns
    _wall_offset_ns = int(offset_s * 1e9)


def iso_utc(wall: int) -> str:
    """ISO 8601 UTC with milliseconds, e.g. ``2026-08-30T12:04:31.120Z``."""
    moment = datetime.fromtimestamp(wall // 1_000_000_000, tz=UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{wall // 1_000_000 % 1000:03d}Z"


def wall_of(iso: str) -> int:
    """Nanoseconds since the epoch of what `iso_utc` wrote; raises ValueError."""
    return int(datetime.fromisoformat(iso).timestamp() * 1000) * 1_000_000
