"""Telling who was refused, without letting whoever is refused fill the log."""

from __future__ import annotations

from collections import OrderedDict

from common import clock, log

EVERY_S = 10.0
"""A further line about the same address, with the number of refusals since the last one, comes no sooner."""
MOST_LINES = 20
"""In EVERY_S, about all addresses together."""
_MOST_ADDRESSES = 256

_LOG = log.get()


class Refusals:
    """Counts refusals by address and logs them as ``event``; ``total`` counts all. Not for two threads at a time."""

    def __init__(self, event: str) -> None:
        self.total = 0
        self._event = event
        self._told: OrderedDict[tuple[str, str], tuple[int, int]] = OrderedDict()
        """When each address was told of last (ns), and how often it was refused since."""
        self._window_ns = 0
        self._lines = 0

    def note(self, address: str, reason: str) -> None:
        """Somebody at ``address`` was refused."""
        self.total += 1
        now, key = clock.monotonic_ns(), (address, reason)
        last_ns, untold = self._told.pop(key, (None, 0))
        due = last_ns is None or now - last_ns >= EVERY_S * 1e9
        if due and self._may_write(now):
            _LOG.warning(self._event, address=address, reason=reason, times=untold + 1)
            self._told[key] = (now, 0)
        else:
            self._told[key] = (now if last_ns is None else last_ns, untold + 1)
        while len(self._told) > _MOST_ADDRESSES:
            self._told.popitem(last=False)

    def _may_write(self, now: int) -> bool:
        if now - self._window_ns >= EVERY_S * 1e9:
            self._window_ns, self._lines = now, 0
        self._lines += 1
        return self._lines <= MOST_LINES
