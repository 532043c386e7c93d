"""What kill -9 left behind: socket files, lock files, shared memory. What is alive is never touched."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import psutil

from common.bus import LOCK_SUFFIX, Endpoints, clear_dead, holder_of
from common.frames import dead_segments, sweep
from common.service.levels import LEVELS_FILE
from services.capture.last_life import SUFFIX as NOTE_SUFFIX
from services.store.choice import CHOICE_FILE
from tools.stack.programs import PID_FILE, SOCKET_FILE

_PID = re.compile(r"\(pid (\d+)\)$")


def living(endpoints: Endpoints) -> tuple[str, ...]:
    """Who holds a name or a socket of this stack right now, e.g. ``control (pid 4711)``."""
    holders = {holder for lock in _locks(endpoints.run_dir) if (holder := holder_of(lock)) is not None}
    return tuple(sorted(holders))


def orphans(endpoints: Endpoints) -> tuple[int, ...]:
    """The processes of this stack that no supervisord looks after: theirs was killed."""
    pids = {int(found[1]) for holder in living(endpoints) if (found := _PID.search(holder))}
    return tuple(sorted(pid for pid in pids | _services(endpoints) if not _supervised(pid)))


def _services(endpoints: Endpoints) -> set[int]:
    """The services that `tagmill up` started: also those that hold no name yet, or no longer, but still run."""
    own = {"TAGMILL_PREFIX": endpoints.prefix, "TAGMILL_RUN_DIR": str(endpoints.run_dir.parent)}
    found = set()
    for process in psutil.process_iter():
        try:
            if any(word.startswith("services.") for word in process.cmdline()):
                environment = process.environ()
                if own.items() <= environment.items():
                    found.add(process.pid)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue  # it has ended, or is somebody else's
    return found


def _supervised(pid: int) -> bool:
    try:
        parent = psutil.Process(pid).parent()
        return parent is not None and any("supervisord" in word for word in parent.cmdline())
    except psutil.NoSuchProcess:
        return False


def clear(endpoints: Endpoints) -> tuple[str, ...]:
    """Remove what dead processes left; returns what was removed.

    A socket file goes by the lock beside it: whoever binds an ipc path holds ``<path>.lock``. A segment goes by
    the lock on itself.
    """
    folder = endpoints.run_dir
    cleared = clear_dead(folder)
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        alone = path.is_socket() and path.name != SOCKET_FILE and not path.with_name(path.name + LOCK_SUFFIX).exists()
        if alone:
            path.unlink(missing_ok=True)
            cleared.append(path.name)
    cleared += _clear_supervisor(folder)
    return (*cleared, *sweep(endpoints.prefix))


def remains(endpoints: Endpoints) -> tuple[str, ...]:
    """What ``clear`` would remove of locks, sockets and segments; for a stack that doesn't run."""
    folder = endpoints.run_dir
    sockets = [path for path in sorted(folder.iterdir()) if path.is_socket()] if folder.is_dir() else []
    dead = [path for path in _locks(folder) if holder_of(path) is None]
    alone = [path for path in sockets if not _answers(path)]
    return (*(path.name for path in (*dead, *alone)), *dead_segments(endpoints.prefix))


def _locks(folder: Path) -> tuple[Path, ...]:
    return tuple(sorted(folder.glob(f"*{LOCK_SUFFIX}"))) if folder.is_dir() else ()


def _clear_supervisor(folder: Path) -> list[str]:
    """The supervisor's socket (nobody listens there any more) and its pid file."""
    path = folder / SOCKET_FILE
    if path.exists() and _answers(path):
        return []
    cleared = []
    # supervisord binds <socket>.<pid> first and then links it to its name.
    for left in (path, *sorted(folder.glob(f"{SOCKET_FILE}.*")), folder / PID_FILE):
        if left.exists():
            left.unlink(missing_ok=True)
            cleared.append(left.name)
    # No remains of a crash, so nothing to tell: the session that was chosen for the stack's life, which is over.
    (folder / CHOICE_FILE).unlink(missing_ok=True)
    (folder / LEVELS_FILE).unlink(missing_ok=True)
    # What capture processes leave for the next one, should they die: there is no next one.
    for note in folder.glob(f"*{NOTE_SUFFIX}"):
        note.unlink(missing_ok=True)
    return cleared


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(2.0)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:
            return True  # it doesn't answer in time, yet it is there
        return True
