"""Locks that name their holder, and end with it: ``flock`` on a small file.

A second bind on an ipc path would steal it without an error, so each binder holds the lock of its path first.
A dead process holds no flock, so no pid is ever guessed about.
"""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from types import TracebackType

from common.errors import ConfigError, NameTakenError

LOCK_SUFFIX = ".lock"
_MAX_HOLDER_BYTES = 200


class NameLock:
    """An exclusive lock on ``path``, taken at once or refused with NameTakenError.

    ``holder`` is what a refused process is told, beside the pid. ``release`` removes the file. A *forked* child
    would share the lock: start workers with ``spawn`` or ``forkserver``.
    """

    def __init__(self, path: Path, holder: str) -> None:
        self.path = path
        self._fd: int | None = _take(path)
        os.ftruncate(self._fd, 0)
        os.pwrite(self._fd, f"{holder} (pid {os.getpid()})".encode()[:_MAX_HOLDER_BYTES], 0)

    def release(self) -> None:
        """Remove the file and give the name back; idempotent."""
        if self._fd is None:
            return
        # Removed while held: whoever opened this file before and locks it now sees that it is gone, and retries.
        self.path.unlink(missing_ok=True)
        os.close(self._fd)
        self._fd = None

    def __enter__(self) -> NameLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def holder_of(path: Path) -> str | None:
    """Who holds the lock ``path`` right now, None if nobody does."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _holder(fd)
    finally:
        os.close(fd)
    return None


def clear_dead(folder: Path) -> list[str]:
    """Remove the lock files of dead holders in ``folder``, and the socket files that they guarded; their names.

    A socket file goes by the lock beside it: whoever binds an ipc path holds ``<path>.lock``.
    """
    cleared: list[str] = []
    for path in sorted(folder.glob(f"*{LOCK_SUFFIX}")):
        try:
            lock = NameLock(path, "who clears what the dead left")
        except NameTakenError:
            continue
        with lock:
            guarded = path.with_name(path.name.removesuffix(LOCK_SUFFIX))
            cleared.append(path.name)
            if guarded.is_socket():
                guarded.unlink(missing_ok=True)
                cleared.append(guarded.name)
    return cleared


def _take(path: Path) -> int:
    while True:
        try:
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise ConfigError(
                f"the lock file {path} can't be opened ({error.strerror}); check TAGMILL_RUN_DIR"
            ) from error
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _holder(fd)
            os.close(fd)
            if error.errno not in {errno.EAGAIN, errno.EACCES}:
                raise
            raise NameTakenError(
                f"{path.stem} is held by {holder}; stop that one first, or use another TAGMILL_PREFIX"
            ) from error
        if _is_file(fd, path):
            return fd
        os.close(fd)


def _is_file(fd: int, path: Path) -> bool:
    """Whether ``fd`` still is the file at ``path``: its last holder may have removed it meanwhile."""
    try:
        now = path.lstat()
    except FileNotFoundError:
        return False
    held = os.fstat(fd)
    return (held.st_dev, held.st_ino) == (now.st_dev, now.st_ino)


def _holder(fd: int) -> str:
    return os.pread(fd, _MAX_HOLDER_BYTES, 0).decode("utf-8", "replace") or "an unknown process"
