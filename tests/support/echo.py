"""A service for tests of the runner and the bus: does each order once, on disk, and misbehaves when told to.

Run like any other: ``python -m tests.support.echo --rig F``. What it does with an order is in the order's
``recording``: ``die-once`` (kill -9 of itself between doing and answering, the first time), ``bug``,
``thread-bug``, ``thread-stuck``, ``faulty``, ``slow-drain`` (never drained), ``hang`` (does not come back), else just
an answer.
"""

from __future__ import annotations

import os
import signal
import sys
import threading

from common.bus import OrderServer, Poller, Subscriber
from common.messages import Answer, LedgerQuery
from common.service import Context, Report, main
from common.topics import LABELS, SERVICE

DONE = "done.txt"


class EchoService:
    """Consumes orders (LedgerQuery) and heartbeats; produces answers and ``done.txt`` beside the rig file."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._done_path = context.rig.folder / DONE
        self._poller = Poller()
        self._orders: OrderServer | None = None
        self._bus: Subscriber | None = None
        self._drained = True
        self._faulty = False

    def open(self) -> None:
        self._orders = OrderServer(self._context.endpoints.ipc("echo-orders"), LedgerQuery, self._context.id)
        self._bus = Subscriber(self._context.endpoints)
        self._bus.subscribe(SERVICE)
        self._bus.subscribe(LABELS)
        self._poller.add(self._orders)
        self._poller.add(self._bus)

    def step(self, timeout_s: float) -> None:
        assert self._orders is not None
        assert self._bus is not None
        self._poller.wait(timeout_s)
        self._bus.receive()
        for return_, order in self._orders.receive():
            assert isinstance(order, LedgerQuery)
            self._obey(order)
            self._orders.answer(return_, Answer(key=order.key, text="done"))

    def drain(self) -> bool:
        return self._drained

    def close(self) -> None:
        for part in (self._orders, self._bus):
            if part is not None:
                part.close()

    def report(self) -> Report:
        bad = 0 if self._bus is None or self._orders is None else self._bus.bad + self._orders.bad
        return Report(dropped={"garbage": bad}, faulty=self._faulty)

    def _obey(self, order: LedgerQuery) -> None:
        done = self._done_path.read_text().split() if self._done_path.exists() else []
        first = order.key not in done
        if first:
            with self._done_path.open("a") as file:
                file.write(order.key + "\n")
                file.flush()
                os.fsync(file.fileno())
        match order.recording:
            case "die-once" if first:
                os.kill(os.getpid(), signal.SIGKILL)
            case "bug":
                raise RuntimeError("told to have a bug")
            case "thread-bug":
                threading.Thread(target=_crash, name="crasher").start()
            case "thread-stuck":
                threading.Thread(target=threading.Event().wait, args=(60,), name="stuck", daemon=True).start()
            case "faulty":
                self._faulty = not self._faulty
            case "slow-drain":
                self._drained = False
            case "hang":
                threading.Event().wait(60)


def _crash() -> None:
    raise RuntimeError("told to crash in a thread")


if __name__ == "__main__":
    sys.exit(main(EchoService, "echo"))
