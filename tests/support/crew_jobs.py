"""What the workers of the crew's tests do: a module of its own, since they import it by name."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

_base = 0
_nice_at_first = 0


def prepare(base: int) -> None:
    global _base, _nice_at_first
    _base, _nice_at_first = base, os.getpriority(os.PRIO_PROCESS, 0)


def refuse_to_start(_base: int) -> None:
    os._exit(3)


def work(job: str | int) -> int:
    """A number is added to the base; a word is a misfortune, ``once PATH`` one that happens the first time only."""
    match str(job).split():
        case ["bug"]:
            raise ValueError("no such number")
        case ["die"]:
            os.kill(os.getpid(), signal.SIGKILL)
        case ["once", path]:
            if not Path(path).exists():
                Path(path).touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return _base
        case ["hang"]:
            threading.Event().wait(600)
        case ["pid"]:
            return os.getpid()
        case ["nice"]:
            return os.getpriority(os.PRIO_PROCESS, 0)
        case ["nice", "at", "first"]:
            return _nice_at_first
        case ["until", pipe]:
            Path(pipe).read_bytes()  # until its other end was opened and closed
            return _base
    return _base + int(job)


def give_back(job: bytes) -> bytes:
    return job
