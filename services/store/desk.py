"""Carries out orders: for each kind, what must be durable before its answer."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

from common import clock
from common.bus import Return
from common.clock import iso_utc, wall_ns
from common.config import Rig, load_rig
from common.dataset import SessionCamera
from common.errors import RefusedError, TagmillError
from common.ids import NAME_PATTERN
from common.laps import StepMeans
from common.log import get
from common.messages import (
    Answer,
    CameraState,
    ErrorInfo,
    LedgerOrder,
    LedgerQuery,
    ListOrder,
    MoveOrder,
    NewestOrder,
    Order,
    ReloadOrder,
    SessionOrder,
    StoreOrder,
)
from common.service.meters import Rate, Tally
from services.store.accounts import Accounts, Give
from services.store.background import DiskThread
from services.store.choice import Choice, remember
from services.store.encode import Coding
from services.store.gallery import Gallery, Tell
from services.store.keeper import Phase, SessionKeeper
from services.store.orders import StoreOrders, fault
from services.store.sessions import SESSION_DIFFERS, Wanted
from services.store.worker import WriteJob, Written
from services.store.writer import Writer


class OrderDesk:
    """Takes orders and gives each its one final answer (``answer``).

    While a session is being opened orders wait; without a session they are refused with the reason.
    ``cameras``: the newest description of each camera. ``refused`` counts by code, ``stored`` samples.
    """

    def __init__(
        self,
        keeper: SessionKeeper,
        writer: Writer,
        disk: DiskThread,
        reader: DiskThread,
        wanted: Wanted,
        answer: Give,
        tell: Tell,
        run_dir: Path,
    ) -> None:
        self._keeper, self._writer, self._disk, self._wanted, self._answer = keeper, writer, disk, wanted, answer
        self._run_dir = run_dir
        self._remembering = 0
        self._accounts = Accounts(keeper, disk, self._answer, self._refuse)
        self._gallery = Gallery(keeper, disk, reader, self._answer, tell)
        self._orders = StoreOrders()
        self._parked: deque[tuple[Return, Order]] = deque()
        self._switches: deque[Callable[[], None]] = deque()
        self.cameras: dict[str, CameraState] = {}
        self.refused = Tally()
        self.stored = Rate()
        self.bytes_written = 0
        self.steps = StepMeans()
        self.newest_order_ns = 0

    @property
    def backlog(self) -> int:
        """Orders without an answer that wait for the disk or for a session."""
        return len(self._orders) + len(self._parked)

    @property
    def idle(self) -> bool:
        """Whether every order has its answer."""
        at_the_disk = self._remembering or self._accounts.busy or self._gallery.busy
        return not (self.backlog or self._switches or at_the_disk) and self._keeper.settled

    def open(self) -> None:
        """Begin to open the rig's session."""
        self._keeper.open(self._wanted, lambda _error: None)

    def take(self, return_: Return, order: Order) -> None:
        """An order came."""
        self.newest_order_ns = clock.monotonic_ns()
        if self._held_up:
            self._parked.append((return_, order))
        else:
            self._carry_out(return_, order)

    def go_on(self) -> None:
        """Once a round: change the session when nothing is in work, and take up what waited for that."""
        if self._switches and not self._orders and self._keeper.settled:
            self._switches.popleft()()
        while self._parked and not self._held_up:
            self._carry_out(*self._parked.popleft())
        self._gallery.follow()

    def close(self) -> None:
        """No more samples are read for the list."""
        self._gallery.close()

    @property
    def _held_up(self) -> bool:
        return bool(self._switches) or self._keeper.phase is Phase.OPENING

    def _carry_out(self, return_: Return, order: Order) -> None:
        try:
            match order:
                case StoreOrder():
                    self._store(return_, order)
                case LedgerOrder():
                    self._accounts.account(return_, order)
                case LedgerQuery():
                    self._query(return_, order)
                case SessionOrder():
                    self._session(return_, order)
                case ReloadOrder():
                    self._reload(return_, order)
                case MoveOrder():
                    self._gallery.move(return_, order)
                case NewestOrder():
                    self._gallery.newest(return_, order)
                case ListOrder():
                    self._gallery.list(return_, order, self._wanted.root)
                case _:
                    raise RefusedError(f"the store takes no {type(order).__name__}", code="bad_order")
        except TagmillError as error:
            self._refuse(return_, order, _info(error))

    def _refuse(self, return_: Return, order: Order, error: ErrorInfo) -> None:
        self.refused.add(error.code)
        self._answer(return_, Answer(key=order.key, error=error))

    # --- samples ------------------------------------------------------------------------------------------

    def _store(self, return_: Return, order: StoreOrder) -> None:
        if (wrong := fault(order)) is not None:
            self._refuse(return_, order, wrong)
        elif self._orders.join(return_, order):
            pass
        elif (before := self._orders.refusal(order)) is not None:
            self._answer(return_, before)
        elif self._keeper.has(order.key):
            self._answer(return_, Answer(key=order.key, samples=(order.key,)))
        else:
            self._orders.begin(return_, order)
            self._begin(order)

    def _begin(self, order: StoreOrder) -> None:
        book = self._keeper.book
        if book is None:
            assert self._keeper.refusal is not None
            self._finish(order, self._keeper.refusal)
            return
        if changed := book.camera_differences(order.label.camera):
            message = f"{'; '.join(changed)} (session {book.name}); open another session for it: 'tagmill session NAME'"
            self._finish(order, ErrorInfo(code=SESSION_DIFFERS, message=message))
            return
        # A camera's first sample waits until session.json knows the camera.
        revision = book.meet_camera(self._describe(order))
        self._keeper.when_durable(revision, lambda error: self._write(order, error), urgent=True)

    def _describe(self, order: StoreOrder) -> SessionCamera:
        state, depth = self.cameras.get(order.camera), order.label.depth
        return SessionCamera(
            since=iso_utc(wall_ns()),
            camera=order.label.camera,
            depth_unit_mm=None if depth is None else depth.unit_mm,
            driver=None if state is None else state.driver,
            fps=None if state is None else state.fps,
        )

    def _write(self, order: StoreOrder, error: ErrorInfo | None) -> None:
        session = self._keeper.session
        if error is not None or session is None:
            self._finish(order, error or self._keeper.refusal)
            return
        label = order.label.model_copy(update={"session": session.book.name})
        job = WriteJob(session.folder, label, order.ring, order.slot, Coding.of(self._wanted.rig.config.dataset))
        self._writer.submit(job, lambda written: self._written(order, written), first=order.urgent)

    def _written(self, order: StoreOrder, written: Written) -> None:
        if written.error is None and order.key not in self._keeper.samples:
            self._keeper.samples.add(order.label.sample)  # the very string that the list of samples keeps, too
            self.stored.mark()
            self.bytes_written += written.bytes
            self.steps.add(written.laps)
            if self._keeper.book is not None:
                self._keeper.book.sample_stored(order.recording, order.camera)
            self._gallery.stored(order.label, written.pictures)
        self._finish(order, written.error)

    def _finish(self, order: StoreOrder, error: ErrorInfo | None) -> None:
        if error is not None:
            self.refused.add(error.code)
        answer = Answer(key=order.key, error=error, samples=() if error else (order.key,))
        for return_ in self._orders.finish(order, answer):
            self._answer(return_, answer)
        for return_, query in self._orders.due():
            self._accounts.query(return_, query)

    # --- the ledger ---------------------------------------------------------------------------------------

    def _query(self, return_: Return, order: LedgerQuery) -> None:
        # Who asks for all takes recordings up again after a crash: samples still under way must be counted by then.
        if order.recording is not None or not self._orders.hold(return_, order):
            self._accounts.query(return_, order)

    # --- sessions -----------------------------------------------------------------------------------------

    def _session(self, return_: Return, order: SessionOrder) -> None:
        if not re.fullmatch(NAME_PATTERN, order.name):
            raise RefusedError(
                f"'{order.name[:80]}' can't be a session's name; use letters, digits, - _ .", code="bad_name"
            )
        if self._keeper.book is not None and order.name != self._keeper.book.name:
            self._require_nothing_running()
        self._switch(
            return_,
            order,
            lambda now: replace(now, name=order.name, new_if_different=order.new_if_different),
        )

    def _reload(self, return_: Return, order: ReloadOrder) -> None:
        path = self._wanted.rig.path
        self._disk.submit(lambda: load_rig(path), lambda done: self._reloaded(return_, order, done))

    def _reloaded(self, return_: Return, order: ReloadOrder, done: Future[Rig]) -> None:
        try:
            rig = done.result()
            dataset, known = rig.config.dataset, self._wanted.rig.config.dataset
            moved = rig.dataset_root != self._wanted.root or dataset.session != known.session
            if moved:
                self._require_nothing_running()
            name = dataset.session if moved or self._keeper.book is None else self._keeper.book.name
            self._switch(return_, order, lambda now: replace(now, rig=rig, root=rig.dataset_root, name=name))
        except TagmillError as error:
            self._refuse(return_, order, _info(error))

    def _require_nothing_running(self) -> None:
        # Where the folder is gone no recording can be ended, and another session is the only way on.
        if (book := self._keeper.book) is not None and not self._keeper.disk.gone and (running := book.running()):
            raise RefusedError(
                f"recording {running[0]} is running; stop it before another session is opened", code="wrong_state"
            )

    def _switch(self, return_: Return, order: Order, change: Callable[[Wanted], Wanted]) -> None:
        """Open what ``change`` makes of the present wish, once nothing is in work; orders wait for that."""

        def switch() -> None:
            wanted = change(self._wanted)
            self._keeper.open(wanted, lambda error: self._switched(return_, order, wanted, error))

        self._switches.append(switch)

    def _switched(self, return_: Return, order: Order, wanted: Wanted, error: ErrorInfo | None) -> None:
        if error is not None:
            self._refuse(return_, order, error)
            return
        assert self._keeper.book is not None
        self._wanted = wanted
        choice = Choice(life=wanted.life, root=wanted.root, name=self._keeper.book.name)
        run_dir = self._run_dir
        self._remembering += 1
        self._disk.submit(
            lambda: remember(run_dir, choice), lambda done: self._remembered(return_, order, choice, done)
        )

    def _remembered(self, return_: Return, order: Order, choice: Choice, done: Future[None]) -> None:
        """Only now is it said that the session is open: a store killed from here on goes on in it."""
        self._remembering -= 1
        try:
            done.result()
        except OSError as error:
            why = error.strerror or str(error)
            get().warning("session.not_remembered", folder=str(self._run_dir), session=choice.name, why=why)
        self._answer(return_, Answer(key=order.key, text=choice.name))


def _info(error: TagmillError) -> ErrorInfo:
    problems = getattr(error, "problems", ())
    return ErrorInfo(code=error.code, message="; ".join(problems) or error.message)
