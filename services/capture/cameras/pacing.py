"""Keeping a frame rate, for drivers whose frames don't come by themselves."""

from __future__ import annotations

import time

from common import clock


class Pacer:
    """Says when the next frame of a stream of ``fps`` frames a second is due.

    Who comes late by more than a frame begins anew from there: lost time is not made up by a burst.
    """

    def __init__(self, fps: float) -> None:
        self._period_ns = int(1e9 / fps)
        self._due_ns: int | None = None

    def restart(self) -> None:
        """The next frame is due at once."""
        self._due_ns = None

    def wait(self, timeout_s: float) -> bool:
        """Wait until the next frame is due, True; or False after ``timeout_s`` if it is due later than that."""
        now = clock.monotonic_ns()
        due = now if self._due_ns is None else self._due_ns
        if due - now > timeout_s * 1e9:
            time.sleep(timeout_s)
            return False
        if due > now:
            time.sleep((due - now) / 1e9)
        self._due_ns = (due if now - due < self._period_ns else now) + self._period_ns
        return True
