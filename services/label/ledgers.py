"""Tells the store each recording's account, and knows when the store has it. One order under way a recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from common import clock
from common.ledgers import CameraLedger
from common.log import get
from common.messages import Answer, ErrorInfo, LedgerOrder
from services.label.requests import Recording, Request

_AGAIN_NS = 1_000_000_000
"""After a refusal the store is told again no sooner than this."""


@dataclass(eq=False)
class _Told:
    """What the store was told last of one recording."""

    account: CameraLedger
    order_key: str | None
    closing: bool
    again_ns: int = 0


@dataclass(frozen=True)
class Closing:
    """The store's answer to a recording's last account; with an ``error`` it will be told again."""

    recording: Recording
    error: ErrorInfo | None


class Ledgers:
    """What the store knows of the recordings of this process; ``boot`` keeps order keys of two lives apart."""

    def __init__(self, boot: str = "") -> None:
        self._boot = boot
        self._told: dict[int, tuple[Recording, _Told]] = {}
        self._orders = 0

    def due(self, recordings: Iterable[Recording]) -> Iterator[LedgerOrder]:
        """Orders for accounts that changed since the store was told; the last one of a recording closes it."""
        now = clock.monotonic_ns()
        for item in recordings:
            told = self._told[id(item)][1] if id(item) in self._told else None
            if item.phase == "ended" or (told is not None and (told.order_key is not None or now < told.again_ns)):
                continue
            closing = item.phase == "finishing" and not item.account.pending
            if closing:
                item.account.close()
            account = item.account.ledger()
            if not closing and told is not None and told.account == account:
                continue
            if closing and item.ended_at is None:
                item.ended_at = clock.iso_utc(clock.wall_ns())
            key = self._key(item.recording, item.camera)
            self._told[id(item)] = (item, _Told(account, key, closing))
            yield LedgerOrder(key=key, spec=item.spec, camera=item.camera, account=account, ended=closing, why=item.why)

    def of_request(self, request: Request) -> LedgerOrder:
        """The one entry of a single request, written when nothing of it is under way any more."""
        return LedgerOrder(
            key=self._key(request.recording, request.camera),
            spec=request.spec(),
            camera=request.camera,
            account=request.account.ledger(),
            ended=True,
            why="answered",
        )

    def answered(self, answer: Answer) -> Closing | None:
        """The store's answer; returns what it means for a recording that was to be closed by it."""
        for item, told in self._told.values():
            if told.order_key != answer.key:
                continue
            told.order_key = None
            if answer.error is not None:
                get().warning("ledger.refused", recording=item.recording, reason=answer.error.message)
                told.again_ns = clock.monotonic_ns() + _AGAIN_NS
                return Closing(item, answer.error) if told.closing else None
            if not told.closing:
                return None
            del self._told[id(item)]
            item.phase = "ended"
            return Closing(item, None)
        return None

    def _key(self, recording: str, camera: str) -> str:
        self._orders += 1
        return f"ledger/{recording}/{camera}/{self._boot}/{self._orders}"
