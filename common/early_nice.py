"""A worker process is out of the cameras' way from its first moment: its imports take most of a second of CPU time.

On Linux niceness belongs to a thread, and nobody may take it back without rights. So the thread for a worker's urgent
jobs is made before, and waits for its work. ``common.first`` imports this before all else; the process's name tells a
worker from a service.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from multiprocessing import current_process
from queue import SimpleQueue
from threading import Thread

_NAMED = "worker niced by "

_not_niced: SimpleQueue[Callable[[], None]] = SimpleQueue()
_begun = False


def name_of(nice: int) -> str:
    """The name of a worker's process."""
    return f"{_NAMED}{nice}"


def begin() -> None:
    """Nice this thread as the process's name says; idempotent."""
    global _begun
    name = current_process().name
    if _begun or not name.startswith(_NAMED):
        return
    _begun = True
    Thread(target=_wait_for_work, name="urgent", daemon=True).start()
    os.nice(int(name.removeprefix(_NAMED)))


def run_beside(work: Callable[[], None]) -> None:
    """Let the thread that isn't niced do ``work``, once."""
    _not_niced.put(work)


def _wait_for_work() -> None:
    _not_niced.get()()


begin()
