"""Which recordings ran when this process last died: asked of the store until it says."""

from __future__ import annotations

from common.bus import OrderClient
from common.ledgers import Ledger
from common.messages import Answer, LedgerQuery


class Resumption:
    """One question to the store, asked again at each of its signs of life until it is answered without an error."""

    def __init__(self, store: OrderClient, name: str) -> None:
        self._store = store
        self._name = name
        self._asked = 0
        self._key = ""
        self._running: tuple[Ledger, ...] | None = None
        self._over = False
        self._ask()

    @property
    def key(self) -> str:
        """The key of the order under way (or of the last one)."""
        return self._key

    @property
    def over(self) -> bool:
        """Whether the recordings have been taken."""
        return self._over

    def store_seen(self) -> None:
        """The store is alive: ask again if it refused."""
        if self._running is None and self._key not in self._store.pending:
            self._ask()

    def answered(self, answer: Answer) -> bool:
        """Whether this was the answer to the question."""
        if answer.key != self._key:
            return False
        self._running = None if answer.error is not None else answer.ledgers
        return True

    def take(self) -> tuple[Ledger, ...]:
        """The recordings to go on with, once; nothing before the store has said."""
        if self._over or self._running is None:
            return ()
        self._over = True
        return self._running

    def _ask(self) -> None:
        self._asked += 1
        self._key = f"query/{self._name}/{self._asked}"
        self._store.send(LedgerQuery(key=self._key))
