"""The store: makes samples durable, keeps the session's ledger, and answers only for what is on the disk.

Consumes: orders (``StoreOrder``, ``LedgerOrder``, ``LedgerQuery``, ``SessionOrder``, ``ReloadOrder``), the topic
``camera``, pixels from sample rings, and orders about stored samples (``MoveOrder``, ``ListOrder``, ``NewestOrder``).
Produces: the dataset, answers, the topic ``samples``, its state.
States: running; faulty while nothing can be stored (another rig's session, disk full, read-only or gone): it then
stays, says why, refuses orders with that reason, and goes on by itself when the disk is back.
"""

from __future__ import annotations

import os

from common import clock
from common.bus import OrderServer, Poller, Publisher, Subscriber
from common.clock import wall_ns
from common.messages import CameraState, SamplesChanged, StoreSideOrder, Warned
from common.service import Context, Report
from common.topics import CAMERA, SAMPLES
from services.store.background import Completions, DiskThread
from services.store.choice import recall
from services.store.desk import OrderDesk
from services.store.disk import RESERVE_BYTES
from services.store.gallery import What
from services.store.keeper import SessionKeeper
from services.store.life import stack_life
from services.store.sessions import SESSION_DIFFERS, Wanted
from services.store.writer import Writer

_QUIET_NS = 500_000_000
"""A store that drains while recordings run waits this long for the last word about them."""

_CLOSE_S = 1.0


class StoreService:
    """One a stack. The loop never waits for the disk: a thread and worker processes do."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._completions = Completions()
        self._poller = Poller(self._completions)
        self._disk: DiskThread | None = None
        self._reader: DiskThread | None = None
        self._writer: Writer | None = None
        self._keeper: SessionKeeper | None = None
        self._warned: dict[str, Warned] = {}

    def open(self) -> None:
        """Bind, start the workers, begin to open the session; raises NameTakenError."""
        context = self._context
        self._server = OrderServer(context.endpoints.orders_store, StoreSideOrder, context.id)
        self._subscriber = Subscriber(context.endpoints)
        self._subscriber.subscribe(CAMERA)
        self._publisher = Publisher(context.endpoints, context.id, context.boot)
        self._poller.add(self._server)
        self._poller.add(self._subscriber)
        reserve, delay_s = _from_environment()
        self._disk = DiskThread(self._completions)
        self._reader = DiskThread(self._completions, "store-list")
        self._keeper = SessionKeeper(self._disk, context.log, reserve)
        workers = context.rig.config.workers.store
        self._writer = Writer(context.log, reserve=reserve, delay_s=delay_s, workers=workers)
        self._poller.add(self._writer)
        self._desk = OrderDesk(
            self._keeper,
            self._writer,
            self._disk,
            self._reader,
            self._wanted(),
            self._server.answer,
            self._tell,
            context.endpoints.run_dir,
        )
        self._desk.open()

    def _wanted(self) -> Wanted:
        """The session that was chosen last in this life of the stack; at first the rig's."""
        rig, life = self._context.rig, stack_life()
        return Wanted(
            root=rig.dataset_root,
            name=recall(self._context.endpoints.run_dir, life, rig.dataset_root) or rig.config.dataset.session,
            rig=rig,
            life=life,
            new_if_different=self._context.args.new_session,
        )

    def step(self, timeout_s: float) -> None:
        """Hear cameras and orders, pass on what the workers and the disk have finished."""
        assert self._keeper is not None
        assert self._writer is not None
        self._poller.wait(min(timeout_s, self._keeper.tick()))
        self._hear_cameras()
        for return_, order in self._server.receive():
            self._desk.take(return_, order)
        self._completions.run()
        self._writer.collect()
        self._desk.go_on()

    def _tell(self, session: str, what: What, samples: tuple[str, ...]) -> None:
        assert self._keeper is not None
        stored, in_bin = len(self._keeper.samples), len(self._keeper.binned)
        news = SamplesChanged(session=session, what=what, samples=samples, stored=stored, in_bin=in_bin)
        self._publisher.publish(SAMPLES, (), news)

    def _hear_cameras(self) -> None:
        for received in self._subscriber.receive():
            state = received.message
            # Without a ring its process is just opening the camera, and doesn't know yet what that is.
            if isinstance(state, CameraState) and state.ring:
                self._desk.cameras[state.camera.name] = state
                self._check_camera(state)

    def _check_camera(self, state: CameraState) -> None:
        """Warn before the first sample is refused, if a camera has another calibration than in this session."""
        assert self._keeper is not None
        book, name = self._keeper.book, state.camera.name
        changed = () if book is None else book.camera_differences(state.camera)
        if not changed:
            self._warned.pop(name, None)
        elif name not in self._warned:
            text = (
                f"{'; '.join(changed)}: its samples are refused until another session is opened ('tagmill session "
                "NAME'), or the camera is as it was"
            )
            self._warned[name] = Warned(wall_ns=wall_ns(), code=SESSION_DIFFERS, message=text)

    def drain(self) -> bool:
        """True once every order taken has its answer."""
        assert self._keeper is not None
        if not self._desk.idle:
            return False
        waits_for_last_word = self._keeper.book is not None and self._keeper.book.running()
        if waits_for_last_word and clock.monotonic_ns() - self._desk.newest_order_ns <= _QUIET_NS:
            return False
        return not self._keeper.tries_once_more()

    def close(self) -> None:
        """End workers and thread, close sockets, release the session; idempotent."""
        for name in ("_desk", "_server", "_subscriber", "_publisher", "_writer"):
            if (owner := getattr(self, name, None)) is not None:
                owner.close()
        if self._reader is not None:
            self._reader.close(_CLOSE_S)
        if self._disk is not None and not self._disk.close(_CLOSE_S):
            self._context.log.warning("disk.stuck", why="the disk doesn't answer; the process ends without it")
        if self._keeper is not None:
            self._keeper.close()
        self._completions.close()

    def report(self) -> Report:
        """Rates, drops by reason, free bytes, backlog."""
        if self._keeper is None or self._writer is None:
            return Report()
        keeper, desk = self._keeper, self._desk
        problem = keeper.problem
        numbers = {
            "samples": float(len(keeper.samples)),
            "in_bin": float(len(keeper.binned)),
            "backlog": float(desk.backlog),
            "bytes_written": float(desk.bytes_written),
            "workers_replaced": float(self._writer.replaced),
            "bad_messages": float(self._server.bad + self._subscriber.bad),
            **desk.steps.as_numbers(),
        }
        if keeper.disk.free_bytes is not None:
            numbers["free_bytes"] = float(keeper.disk.free_bytes)
        return Report(
            cameras=tuple(sorted(desk.cameras)),
            rates={"stored": desk.stored.per_second()},
            dropped=desk.refused.as_dict() | ({"bus_full": lost} if (lost := self._publisher.dropped) else {}),
            numbers=numbers,
            texts=({} if keeper.book is None else {"session": keeper.book.name})
            | ({} if problem is None else {"problem": problem.code}),
            last_error=None if problem is None else problem.message,
            faulty=problem is not None,
            warnings=tuple(self._warned.values()),
        )


def _from_environment() -> tuple[int, float]:
    """For tests and small disks: the reserve in bytes, and how long a worker waits before it writes (s)."""
    reserve = os.environ.get("TAGMILL_STORE_RESERVE_MB")
    delay_ms = os.environ.get("TAGMILL_STORE_DELAY_MS", "0")
    return RESERVE_BYTES if reserve is None else int(float(reserve) * 1e6), float(delay_ms) / 1000
