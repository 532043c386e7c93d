"""Signals: the first SIGTERM or SIGINT asks for a drain, the second forces the end."""

from __future__ import annotations

import faulthandler
import os
import select
import signal
import sys
from types import FrameType

from common import clock

DRAIN_S = 10.0
CLOSE_S = 4.0
"""After drain and close have had their time, the process says where it hangs and ends with exit code 1."""


class StopRequest:
    """What has been asked so far: ``requested``, ``forced``, and by what (``why``). Made in the main thread.

    Plain attributes and a pipe, no threading.Event: a handler that runs while the main thread is inside
    ``Event.wait`` would wait for a lock which that thread holds.
    """

    def __init__(self) -> None:
        self.requested = False
        self.forced = False
        self.why: str | None = None
        self._ear, self._bell = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    def install(self) -> None:
        """Take over SIGTERM and SIGINT, and those that came while the process was importing."""
        signal.set_wakeup_fd(self._bell, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        early = sys.modules.get("common.early_signals")  # only a service's own process has it
        for held in early.taken() if early is not None else ():
            self._on_signal(held, None)

    def wait(self, timeout_s: float) -> bool:
        """Wait at most ``timeout_s``; True as soon as a stop was requested."""
        deadline = clock.monotonic_ns() + int(timeout_s * 1e9)
        while not self.requested and (left_ns := deadline - clock.monotonic_ns()) > 0:
            if select.select([self._ear], [], [], left_ns / 1e9)[0]:
                os.read(self._ear, 64)
        return self.requested

    def ask(self, why: str) -> None:
        """Request a stop from inside (the end of the process is then enforced as for a signal)."""
        if self.requested:
            return
        self.why = why
        # From here on the end is certain, even if a driver never comes back from its call.
        faulthandler.dump_traceback_later(DRAIN_S + CLOSE_S, exit=True, file=sys.__stderr__ or sys.stderr)
        self.requested = True

    def uninstall(self) -> None:
        """The process ends by itself now: give the signals back, no more need to enforce the end."""
        faulthandler.cancel_dump_traceback_later()
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        os.close(self._ear)
        os.close(self._bell)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        if self.requested:
            self.forced = True
        self.ask(signal.Signals(number).name)
