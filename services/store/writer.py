"""The worker processes that write samples: a queue in front of them, and a new pool when one was killed."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial

from structlog.typing import FilteringBoundLogger

from common.messages import ErrorInfo
from services.store.background import Completions, DiskThread
from services.store.worker import WriteJob, Written, prepare, write

WORKER_DIED = "worker_died"
BUG = "failed"
_MOST_ATTEMPTS = 4
_KILL_S = 1.0
_AHEAD = 1
"""Jobs beyond one a worker that the pool holds, so that no worker waits for the loop."""


@dataclass
class _Task:
    job: WriteJob
    then: Callable[[Written], None]
    attempts: int = 0


class Writer:
    """Writes samples in ``workers`` processes; ``then`` of each job is called once, in the loop's thread.

    ``replaced`` counts the times a worker had died.
    """

    def __init__(
        self,
        completions: Completions,
        disk: DiskThread,
        log: FilteringBoundLogger,
        *,
        reserve: int,
        delay_s: float = 0.0,
        workers: int = 2,
    ) -> None:
        self._completions, self._disk, self._log, self._workers = completions, disk, log, workers
        self._reserve, self._delay_s = reserve, delay_s
        self._waiting: deque[_Task] = deque()
        self._tasks: dict[int, _Task] = {}
        self._next = 0
        self._rebuilding = False
        self.replaced = 0
        self._pool = self._new_pool()

    @property
    def backlog(self) -> int:
        """Jobs that are not finished."""
        return len(self._waiting) + len(self._tasks)

    def submit(self, job: WriteJob, then: Callable[[Written], None]) -> None:
        """Queue a job."""
        self._waiting.append(_Task(job, then))
        self._start()

    def close(self) -> None:
        """End the workers; one that is still writing is killed, and the next start removes what it leaves."""
        if self._tasks:
            children = multiprocessing.active_children()
            for child in children:
                child.kill()
            for child in children:
                child.join(_KILL_S)
        self._pool.shutdown(wait=not self._tasks, cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        pool = ProcessPoolExecutor(
            self._workers, multiprocessing.get_context("spawn"), initializer=prepare, initargs=(os.getpid(),)
        )
        with contextlib.suppress(BrokenProcessPool):  # the first job finds out, and replaces this pool too
            for _ in range(self._workers):  # start them now, so that no sample waits for an interpreter
                pool.submit(os.getpid)
        return pool

    def _start(self) -> None:
        while self._waiting and len(self._tasks) < self._workers + _AHEAD and not self._rebuilding:
            task = self._waiting.popleft()
            task.attempts += 1
            needed = frozenset(other.job.ring for other in (*self._waiting, *self._tasks.values()))
            try:
                future = self._pool.submit(write, task.job, self._reserve, self._delay_s, needed)
            except BrokenProcessPool:
                self._again(task)
                continue
            number, self._next = self._next, self._next + 1
            self._tasks[number] = task
            self._completions.watch(future, partial(self._finished, number))

    def _finished(self, number: int, future: Future[Written]) -> None:
        task = self._tasks.pop(number)
        try:
            result = future.result()
        except BrokenProcessPool:
            self._again(task)
            return
        except Exception:  # noqa: BLE001 - a bug met by one sample is logged and costs that sample, not the service
            self._log.exception("record.failed", sample=task.job.label.sample)
            result = Written(error=ErrorInfo(code=BUG, message="a bug in the store; its log has the details"))
        self._start()
        task.then(result)

    def _again(self, task: _Task) -> None:
        self._rebuild()
        if task.attempts < _MOST_ATTEMPTS:
            self._waiting.appendleft(task)
            return
        message = f"the worker that wrote it died {task.attempts} times; is the machine out of memory?"
        task.then(Written(error=ErrorInfo(code=WORKER_DIED, message=message)))

    def _rebuild(self) -> None:
        """Replace a pool in which a worker was killed, once its last worker is gone: two may not write one sample."""
        if self._rebuilding:
            return
        self._rebuilding = True
        self.replaced += 1
        self._log.warning("worker.died", replaced=self.replaced)
        old = self._pool
        self._disk.submit(lambda: old.shutdown(wait=True), self._replace)

    def _replace(self, done: Future[None]) -> None:
        done.result()
        self._pool = self._new_pool()
        self._rebuilding = False
        self._start()
