"""Ledger orders and questions: accounts are answered once durable, ledgers found wherever they are kept."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from common.bus import Return
from common.clock import wall_ns
from common.dataset.faults import explain
from common.errors import RefusedError, TagmillError
from common.ledgers import Ledger
from common.messages import Answer, ErrorInfo, LedgerOrder, LedgerQuery, Order
from services.store.background import DiskThread
from services.store.keeper import SessionKeeper
from services.store.ledger import no_such
from services.store.sessions import OpenSession

T = TypeVar("T")
Give = Callable[[Return, Answer], None]
Refuse = Callable[[Return, Order, ErrorInfo], None]


class Accounts:
    """The part of the order desk that keeps the ledger. ``busy``: orders that wait for the disk thread."""

    def __init__(self, keeper: SessionKeeper, disk: DiskThread, answer: Give, refuse: Refuse) -> None:
        self._keeper, self._disk, self._answer, self._refuse = keeper, disk, answer, refuse
        self.busy = 0

    def account(self, return_: Return, order: LedgerOrder) -> None:
        """Put a camera's account into the ledger; a single request's is written once and for all."""
        session = self._keeper.require_session()
        book = session.book
        if order.ended and order.spec.mode == "record":
            entry = book.entry(order, wall_ns())
            self._submit(
                session,
                lambda: session.records.append((entry,)),
                lambda error, new: self._entered(return_, order, session, entry, error, bool(new)),
            )
            return
        book.merge(order, wall_ns())

        def answer(error: ErrorInfo | None) -> None:
            ledgers = () if error else book.query(order.spec.recording)
            self._answer(return_, Answer(key=order.key, error=error, ledgers=ledgers))

        self._keeper.when_durable(book.revision, answer, urgent=order.ended)

    def _entered(
        self,
        return_: Return,
        order: Order,
        session: OpenSession,
        entry: Ledger,
        error: ErrorInfo | None,
        new: bool,
    ) -> None:
        if new:
            session.book.count_entry(entry)
        self._answer(return_, Answer(key=order.key, error=error, ledgers=() if error else (entry,)))

    def query(self, return_: Return, order: LedgerQuery) -> None:
        """Answer with one recording's ledger or with those that run."""
        try:
            session = self._keeper.require_session()
        except RefusedError as error:
            self._refuse(return_, order, ErrorInfo(code=error.code, message=error.message))
            return
        name, wanted = session.book.name, order.recording
        if wanted is None or session.book.knows(wanted):
            self._answer(return_, Answer(key=order.key, ledgers=session.book.query(wanted), text=name))
            return

        def found(error: ErrorInfo | None, ledger: Ledger | None) -> None:
            if error is None and ledger is None:
                error = no_such(name, wanted)
            if error is not None:
                self._refuse(return_, order, error)
            elif ledger is not None:
                told = session.book.with_deleted(ledger)
                self._answer(return_, Answer(key=order.key, ledgers=(told,), text=name))

        self._submit(session, lambda: session.records.find(wanted), found)

    def _submit(
        self, session: OpenSession, job: Callable[[], T], then: Callable[[ErrorInfo | None, T | None], None]
    ) -> None:
        def done(future: Future[T]) -> None:
            self.busy -= 1
            try:
                result = future.result()
            except OSError as error:
                then(explain(error, session.folder), None)
            except TagmillError as error:
                then(ErrorInfo(code=error.code, message=error.message), None)
            else:
                then(None, result)

        self.busy += 1
        self._disk.submit(job, done)
