"""A worker process's life: jobs come by a pipe, answers go back by it; what is urgent goes first, at full priority.

A worker is niced, so on a busy machine a job takes ten times as long as its work. The urgent jobs are done by a second
thread, which keeps the priority that the process was started with (``common.early_nice``). The two never work at once:
what they work with isn't made for that.
"""

from __future__ import annotations

import os
import pickle
import signal
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Generic, TypeVar

from common import clock, early_nice, log
from common.log import Level
from common.service.memory import keep_all
from common.service.parent import die_with_parent

J = TypeVar("J")
R = TypeVar("R")


@dataclass(frozen=True)
class Failure:
    """A job without a result. ``fault``: ``exception`` (a bug: ``what`` is its traceback), ``died`` or ``hung``."""

    fault: str
    what: str


@dataclass(frozen=True)
class Begun:
    """Sent in a result's place when an urgent job begins: only the worker knows whether the next one came before it."""


@dataclass(frozen=True)
class Told:
    """A job (pickled) as it comes by the pipe, with the log level of the moment. ``first``: urgent."""

    level: Level
    key: str
    job: bytes
    first: bool


def serve(
    pipe: Connection,
    parent: int,
    service: str | None,
    level: Level,
    work: Callable[[J], R],
    prepare: Callable[..., None],
    prepared_with: tuple[object, ...],
) -> None:
    """A worker's life: says None once it is ready, then ``(key, result)`` for each job; ends with the pipe.

    Of an urgent job it says ``(key, Begun())`` before.
    """
    early_nice.begin()
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not die_with_parent(parent, signal.SIGKILL):
        os._exit(1)
    if service is not None:
        log.setup(service, level)
    prepare(*prepared_with)
    keep_all()
    with suppress(EOFError, ConnectionError):  # the service has closed the pipe: nothing more to do
        pipe.send(None)
        _Turns(pipe, work).run()
    log.shutdown()


class _Turns(Generic[J, R]):
    """Who works: the niced thread that called ``run``, or, while that one waits, the other."""

    def __init__(self, pipe: Connection, work: Callable[[J], R]) -> None:
        self._pipe, self._work = pipe, work
        self._ordinary: deque[Told] = deque()
        self._urgent: SimpleQueue[Told] = SimpleQueue()
        self._urgent_done: SimpleQueue[None] = SimpleQueue()

    def run(self) -> None:
        """Do the jobs until the pipe's end; raises EOFError there."""
        early_nice.run_beside(self._do_urgent)
        while True:
            while not self._ordinary or self._pipe.poll(0):
                self._hear(self._pipe.recv())
            self._do(self._ordinary.popleft())

    def _hear(self, told: Told) -> None:
        if told.first:
            self._urgent.put(told)
            self._urgent_done.get()
        else:
            self._ordinary.append(told)

    def _do_urgent(self) -> None:
        while True:
            told = self._urgent.get()
            with suppress(ConnectionError):  # the other thread reads the end of the pipe
                self._pipe.send((told.key, Begun()))
                self._do(told)
            self._urgent_done.put(None)

    def _do(self, told: Told) -> None:
        if told.level != log.level():  # the service's, which `tagmill log` may have changed
            log.set_level(told.level)
        begun_ns = clock.monotonic_ns()
        try:
            result: R | Failure = self._work(pickle.loads(told.job))  # noqa: S301 - from its own service
        except Exception:  # noqa: BLE001 - a bug met by one job is told and costs that job, not the worker
            result = Failure("exception", traceback.format_exc())
        took_ms = (clock.monotonic_ns() - begun_ns) / 1e6
        log.get().debug("worker.job", job=told.key, pid=os.getpid(), urgent=told.first, took_ms=took_ms)
        self._pipe.send((told.key, result))
