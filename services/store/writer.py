"""The worker processes that write samples, and the queue in front of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from structlog.typing import FilteringBoundLogger

from common.messages import ErrorInfo
from common.service.crew import Crew, Failure
from services.store.worker import NICE, Turn, WriteJob, Written, prepare, write

WORKER_DIED = "worker_died"
BUG = "failed"
_MOST_DEATHS = 4
_LIMIT_S = 300.0
"""A disk that stalls for minutes may come back; what a worker wrote before it was killed is removed or adopted."""
_AHEAD = 1
"""Jobs beyond one a worker that are handed out, so that no worker waits for the loop; an urgent one goes
beyond these."""


@dataclass(frozen=True)
class _Task:
    job: WriteJob
    then: Callable[[Written], None]
    first: bool


class Writer:
    """Writes samples in ``workers`` processes; ``then`` of each job is called once, by ``collect``.

    Jobs wait here, not in the workers' queues: which sample rings are still needed is known best at the last moment.
    """

    def __init__(self, log: FilteringBoundLogger, *, reserve: int, delay_s: float = 0.0, workers: int = 2) -> None:
        self._log, self._reserve, self._delay_s, self._most = log, reserve, delay_s, workers + _AHEAD
        self._waiting: deque[_Task] = deque()
        self._tasks: dict[str, _Task] = {}
        self._next = 0
        self._crew: Crew[Turn, Written] = Crew(
            write, prepare, workers=workers, nice=NICE, deaths=_MOST_DEATHS, limit_s=_LIMIT_S
        )

    @property
    def sockets(self) -> tuple[int, ...]:
        """For the Poller: readable when there is something to collect."""
        return self._crew.sockets

    @property
    def backlog(self) -> int:
        """Jobs that are not finished."""
        return len(self._waiting) + len(self._tasks)

    @property
    def replaced(self) -> int:
        """How many workers have died."""
        return self._crew.replaced

    def submit(self, job: WriteJob, then: Callable[[Written], None], *, first: bool = False) -> None:
        """Queue a job; ``first``: before all that wait, behind those of its kind."""
        at = next((place for place, other in enumerate(self._waiting) if not other.first), len(self._waiting))
        self._waiting.insert(at if first else len(self._waiting), _Task(job, then, first))
        self._hand_out()

    def collect(self) -> None:
        """Tell what was written since the last call; never waits."""
        ended = [(self._tasks.pop(key), result) for key, result in self._crew.finished()]
        self._hand_out()
        for task, result in ended:
            task.then(self._explained(task, result))

    def close(self) -> None:
        """End the workers; what one that had to be killed leaves, the next start removes."""
        self._crew.close()

    def _hand_out(self) -> None:
        while self._waiting and len(self._tasks) < self._most + self._waiting[0].first:
            task = self._waiting.popleft()
            needed = frozenset(other.job.ring for other in (*self._waiting, *self._tasks.values()))
            key, self._next = str(self._next), self._next + 1
            self._tasks[key] = task
            self._crew.submit(key, Turn(task.job, self._reserve, self._delay_s, needed), first=task.first)

    def _explained(self, task: _Task, result: Written | Failure) -> Written:
        if isinstance(result, Written):
            return result
        self._log.error("record.failed", sample=task.job.label.sample, fault=result.fault, what=result.what)
        if result.fault == "exception":
            return Written(error=ErrorInfo(code=BUG, message="a bug in the store; its log has the details"))
        if result.fault == "hung":
            message = f"the disk did not take it within {_LIMIT_S:g} s; is it still there?"
        else:
            message = f"the worker that wrote it died {_MOST_DEATHS} times; is the machine out of memory?"
        return Written(error=ErrorInfo(code=WORKER_DIED, message=message))
