"""Signals that come while a service is still importing: kept for the runner, instead of ending the process unheard.

``common.first`` imports this before all else. A supervisor may stop what it started a moment ago; ended on
the spot, the new process would leave behind what it was about to clear: the remains of a killed predecessor.
"""

from __future__ import annotations

import signal
from types import FrameType

_held: list[int] = []


def _hold(number: int, _frame: FrameType | None) -> None:
    _held.append(number)


def taken() -> tuple[int, ...]:
    """The signals that came so far; the caller has handlers of its own in place and heeds them."""
    numbers = tuple(_held)
    _held.clear()
    return numbers


for _number in (signal.SIGTERM, signal.SIGINT):
    signal.signal(_number, _hold)
