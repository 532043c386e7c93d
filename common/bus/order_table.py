"""What a client of orders has asked and not got answered yet; pure, so that its rules can be tested alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from common.errors import RefusedError

FRESH_NS = 3_000_000_000
"""A peer whose last state is older than this counts as away."""
RESEND_NS = 10_000_000_000
"""How long an order may be without an answer before a living peer is asked again."""


@dataclass(slots=True)
class _Entry:
    data: bytes
    sent_ns: int | None = None
    sent_to: str | None = None


@dataclass
class OrderTable:
    """Unanswered orders by key, in the order of asking.

    Nothing is resent by the clock alone: only ``peer_seen`` and a connection that takes messages again cause it.
    """

    window: int
    entries: dict[str, _Entry] = field(default_factory=dict)
    peer_boot: str | None = None
    peer_seen_ns: int | None = None

    def add(self, key: str, data: bytes) -> bool:
        """Enter an order; False if this key is in the table already. Raises RefusedError ``backlog_full``."""
        if key in self.entries:
            return False
        if len(self.entries) >= self.window:
            raise RefusedError(
                f"{self.window} orders are still unanswered; this one was not accepted", code="backlog_full"
            )
        self.entries[key] = _Entry(data)
        return True

    def flush(self, transmit: Callable[[bytes], bool], now_ns: int) -> None:
        """Send what never went; stops at the first that ``transmit`` can't take (returns False)."""
        for entry in self.entries.values():
            if entry.sent_ns is None and not self._transmit(entry, transmit, now_ns):
                return

    def peer_seen(self, boot: str, transmit: Callable[[bytes], bool], now_ns: int) -> int:
        """A sign of life of the peer in its life ``boot``: resend what a former life took or what is too old.

        Returns how many orders were sent *again*.
        """
        self.peer_boot, self.peer_seen_ns = boot, now_ns
        again = 0
        for entry in self.entries.values():
            due = entry.sent_ns is None or entry.sent_to != boot or now_ns - entry.sent_ns > RESEND_NS
            if not due:
                continue
            repeated = entry.sent_ns is not None
            if not self._transmit(entry, transmit, now_ns):
                break
            again += repeated
        return again

    def answered(self, key: str) -> bool:
        """Take the order out; False if it isn't (or no longer) waited for."""
        return self.entries.pop(key, None) is not None

    def peer_is_fresh(self, now_ns: int) -> bool:
        """Whether the peer gave a sign of life in the last 3 s."""
        return self.peer_seen_ns is not None and now_ns - self.peer_seen_ns <= FRESH_NS

    def _transmit(self, entry: _Entry, transmit: Callable[[bytes], bool], now_ns: int) -> bool:
        if not transmit(entry.data):
            return False
        entry.sent_ns, entry.sent_to = now_ns, self.peer_boot
        return True
