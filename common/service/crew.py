"""Worker processes of a service: jobs by value, one answer each, and a death or a hang that costs only its own job.

A pool of `concurrent.futures` breaks as a whole when one worker dies, can't tell whose job killed it, waits for
ever for one that hangs, and leaves semaphores behind when the service is killed. Here each worker has a pipe.
"""

from __future__ import annotations

import os
import pickle
import select
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

from common import clock, early_nice, log
from common.service.worker import Begun, Failure, Told, serve

J = TypeVar("J")
R = TypeVar("R")

__all__ = ["Crew", "Failure"]

_SPAWN = get_context("spawn")  # a fork would take the service's sockets, threads and locks along
_AHEAD = 2
"""Jobs a worker holds: the one it works on and the next, so that it doesn't wait for the service's loop. An urgent one
is given to it beyond them, and is done before the next."""
_FITS = 128 << 10
"""So many bytes of jobs surely fit into a pipe, which has room for 200,000. A worker reads no more while it does a job:
the service would wait for it, and for ever if its result is as large."""
_END_S = 2.0
_START_NS = 60_000_000_000
"""An interpreter that starts on a busy machine doesn't hang yet."""


@dataclass
class _Task:
    """``job``: pickled."""

    key: str
    job: bytes
    deaths: int = 0
    first: bool = False
    begun: bool = False


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    news: select.poll
    tasks: deque[_Task] = field(default_factory=deque)
    begun_ns: int = 0
    ready: bool = False
    hung: bool = False
    over: bool = False

    def takes(self, task: _Task) -> bool:
        """Whether it has room for one more task: of several, all must fit into the pipe, for not one is surely read."""
        if self.over or len(self.tasks) >= _AHEAD + task.first:
            return False
        return not self.tasks or sum(len(one.job) for one in (*self.tasks, task)) <= _FITS

    def give(self, task: _Task) -> None:
        """Hand a task over; an urgent one is next after the one at hand."""
        if not self.tasks:
            self.begun_ns = clock.monotonic_ns()
        at = next((place for place, other in enumerate(self.tasks) if place and not other.first), len(self.tasks))
        self.tasks.insert(at if task.first else len(self.tasks), task)
        with suppress(ConnectionError):  # dead: `finished` reads that from its pipe, and the task is not lost
            self.pipe.send(Told(log.level(), task.key, task.job, task.first))

    def ended(self, key: str) -> None:
        """The task is done. Not always the first: an urgent one may have come when the next was begun already."""
        self.tasks.remove(self.named(key))

    def named(self, key: str) -> _Task:
        """The task of this key."""
        return next(task for task in self.tasks if task.key == key)

    def at_hand(self) -> _Task | None:
        """What it works on: the first, unless that is an urgent one of whose beginning nothing was heard."""
        first = self.tasks[0] if self.tasks else None
        return next((task for task in self.tasks if task.begun or not task.first), first)


class Crew(Generic[J, R]):
    """Up to ``workers`` processes that do ``work(job)``. One a thread; nothing here waits, except ``close``.

    One is started at once, the others when jobs wait for which it has no room (and stay): an idle worker costs as much
    memory and time to start as a service.

    ``work`` and ``prepare`` are module-level functions; ``prepare(*prepared_with)`` runs once in each worker. A job
    whose worker died under it is done again until it has cost ``deaths`` workers; one that takes longer than
    ``limit_s`` has its worker killed, which counts as a death. The worker's next job is not blamed. A dead worker's
    place is filled when it is surely gone: two never work on one job.

    Workers are niced by ``nice`` from their first moment, but for urgent jobs (``first``).

    A worker ends with the thread that made the crew, and has a process group of its own: a signal to the service's
    group is for the service, which then drains. It logs as the service does, at its level of the moment (``worker.job``
    at debug). ``replaced`` counts the deaths.
    """

    def __init__(
        self,
        work: Callable[[J], R],
        prepare: Callable[..., None],
        prepared_with: tuple[object, ...] = (),
        *,
        workers: int = 1,
        nice: int = 0,
        deaths: int = 3,
        limit_s: float = 30.0,
    ) -> None:
        self._start_with = (work, prepare, prepared_with)
        self._most, self._nice = workers, nice
        self._deaths, self._limit_ns = deaths, int(limit_s * 1e9)
        self._waiting: deque[_Task] = deque()
        self._given_up: list[tuple[str, Failure]] = []
        self.replaced = 0
        self._workers: list[_Worker] = [self._started()]

    @property
    def sockets(self) -> tuple[int, ...]:
        """For the Poller: readable when a job has ended or a worker has died."""
        return tuple(worker.pipe.fileno() for worker in self._workers if not worker.over)

    @property
    def busy(self) -> int:
        """Jobs that ``finished`` has not given back yet."""
        return len(self._waiting) + len(self._given_up) + sum(len(worker.tasks) for worker in self._workers)

    @property
    def pids(self) -> tuple[int, ...]:
        """The workers' process ids."""
        return tuple(worker.process.pid or 0 for worker in self._workers if not worker.over)

    def submit(self, key: str, job: J, *, first: bool = False) -> None:
        """Queue a job; ``key`` comes back with its result. ``first``: before all that wait, behind those of its kind.

        Only the job that a worker has at hand comes before it, and the worker does it at full priority.
        """
        self._queue(_Task(key, pickle.dumps(job), first=first))

    def hurry(self, key: str) -> None:
        """Make a job urgent that waits here; one that a worker has got already, or that isn't known, stays as it is."""
        task = next((task for task in self._waiting if task.key == key), None)
        if task is not None and not task.first:
            self._waiting.remove(task)
            task.first = True
            self._queue(task)

    def finished(self) -> Iterator[tuple[str, R | Failure]]:
        """What ended since the last call, each job once."""
        for worker in self._workers:
            yield from self._heard(worker)
            limit_ns = self._limit_ns if worker.ready else max(_START_NS, self._limit_ns)
            late = clock.monotonic_ns() - worker.begun_ns > limit_ns
            if worker.tasks and late and not (worker.over or worker.hung):
                worker.hung = True
                worker.process.kill()  # its pipe tells when it is dead
        self._fill_places()
        while self._given_up:
            yield self._given_up.pop()
        self._hand_out()

    def close(self) -> None:
        """End the workers: idle ones at once, others have a moment for the job at hand; idempotent."""
        for worker in self._workers:
            worker.pipe.close()  # an idle worker reads the end of its pipe
        for worker in self._workers:
            worker.process.join(_END_S)
            if worker.process.exitcode is None:
                worker.process.kill()
                worker.process.join(_END_S)
        self._workers, self._given_up = [], []
        self._waiting.clear()

    def _started(self) -> _Worker:
        ours, its = _SPAWN.Pipe()
        told = (its, os.getpid(), log.service(), log.level())
        process = _SPAWN.Process(
            target=serve, args=(*told, *self._start_with), name=early_nice.name_of(self._nice), daemon=True
        )
        process.start()
        its.close()
        news = select.poll()  # the pipe's own `poll` makes a new one at each call, and this one is asked all the time
        news.register(ours.fileno(), select.POLLIN)
        return _Worker(process, ours, news, begun_ns=clock.monotonic_ns())

    def _queue(self, task: _Task) -> None:
        at = next((place for place, other in enumerate(self._waiting) if not other.first), len(self._waiting))
        self._waiting.insert(at if task.first else len(self._waiting), task)
        self._hand_out()

    def _hand_out(self) -> None:
        while self._waiting:
            free = [worker for worker in self._workers if worker.takes(self._waiting[0])]
            if not free:
                if all(worker.ready for worker in self._workers):
                    more = min(self._most - len(self._workers), len(self._waiting))
                    self._workers += [self._started() for _ in range(more)]
                return
            min(free, key=lambda item: len(item.tasks)).give(self._waiting.popleft())

    def _heard(self, worker: _Worker) -> Iterator[tuple[str, R | Failure]]:
        while not worker.over and worker.news.poll(0):
            try:
                said = worker.pipe.recv()
            except (EOFError, ConnectionError):
                self._bury(worker)
                return
            worker.begun_ns = clock.monotonic_ns()
            if not worker.ready:
                worker.ready = True  # its first word
                continue
            key, result = said
            if isinstance(result, Begun):
                worker.named(key).begun = True
            else:
                worker.ended(key)
                yield key, result

    def _bury(self, worker: _Worker) -> None:
        """Take its jobs back; the one at hand is to blame."""
        self.replaced += 1
        worker.over = True
        worker.pipe.close()
        worker.process.kill()  # whoever closed its pipe is of no use
        log.get().warning(
            "worker.died", pid=worker.process.pid, hung=worker.hung, jobs=[task.key for task in worker.tasks]
        )
        blamed = worker.at_hand()
        if blamed is not None:
            blamed.deaths += 1
            if blamed.deaths >= self._deaths:
                fault = "hung" if worker.hung else "died"
                what = f"took longer than {self._limit_ns / 1e9:g} s" if worker.hung else "its worker died"
                self._given_up.append((blamed.key, Failure(fault, f"{what}, {self._deaths} times")))
                worker.tasks.remove(blamed)
        for task in worker.tasks:
            task.begun = False
        self._waiting = deque(sorted((*worker.tasks, *self._waiting), key=lambda task: not task.first))
        worker.tasks.clear()

    def _fill_places(self) -> None:
        """A worker that died before it was ready is replaced when there is work again, so that none dies in a loop."""
        for place, worker in enumerate(self._workers):
            if worker.over and worker.process.exitcode is not None and (worker.ready or self._waiting):
                worker.process.close()
                self._workers[place] = self._started()
