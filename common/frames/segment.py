"""A named piece of shared memory: the only module that maps memory.

``multiprocessing.shared_memory`` is not used: before Python 3.13 the exit of a *reader* destroys the owner's
segment (cpython issue 82300). A segment is a file in ``/dev/shm`` (``TAGMILL_SHM_DIR`` names another folder).
Its owner holds ``flock`` on it as long as it lives, so a segment whose lock can be taken is a dead one's.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import re
from pathlib import Path
from typing import Self

from common.errors import FrameLostError, NameTakenError, NoSpaceError

_NAME = re.compile(r"^tagmill-[A-Za-z0-9_.-]{1,240}$")
_NO_ROOM = {errno.ENOSPC, errno.ENOMEM, errno.EFBIG, errno.EDQUOT}
_ATTEMPTS = 5
_MEGABYTE = 1 << 20
_SHM_STEP_MB = 64


def shm_folder() -> Path:
    """The folder of the segments; read at each call, so that a test can have a small one."""
    return Path(os.environ.get("TAGMILL_SHM_DIR") or "/dev/shm")  # noqa: S108 - POSIX shared memory lives there


def shm_room() -> tuple[int, int]:
    """Free bytes and all bytes of shared memory; raises OSError where its folder is gone."""
    return _free(shm_folder())


def segment_name(prefix: str, owner: str, boot: str) -> str:
    """The name of a segment: ``tagmill-<prefix>-<owner>-<boot>``, e.g. ``tagmill-tagmill-cam0-5f3a9c21``."""
    name = f"tagmill-{prefix}-{owner}-{boot}"
    if not _NAME.match(name):
        raise ValueError(f"'{name}' is no name of a segment (letters, digits, _ . - only)")
    return name


class Segment:
    """A mapped segment. Made by ``create`` (the one owner) or ``attach`` (any number of others).

    ``buffer`` is the mapping; arrays made from it keep the memory mapped, so drop them before ``close``.
    """

    def __init__(self, name: str, descriptor: int, size: int, *, owned: bool, writable: bool) -> None:
        self.name = name
        self.size = size
        self._owned = owned
        self._descriptor: int | None = descriptor
        self._map = mmap.mmap(descriptor, size, access=mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ)
        self._buffer: memoryview | None = memoryview(self._map)

    @classmethod
    def create(cls, name: str, size: int, first: int | None = None) -> Segment:
        """Make, lock and allocate a segment of ``size`` bytes, all 0, readable by this user only.

        Raises NameTakenError if the name exists, NoSpaceError if the memory isn't there; allocated now, it
        can't kill a writer by SIGBUS later. With ``first`` only so many bytes are allocated now (a large segment takes
        longer than a frame may), and the rest by ``allocate`` before it is touched.
        """
        _check_name(name)
        path = shm_folder() / name
        _check_room(path.parent, name, size)
        descriptor = _open_locked(path)
        try:
            os.ftruncate(descriptor, size)
            os.posix_fallocate(descriptor, 0, size if first is None else first)
            return cls(name, descriptor, size, owned=True, writable=True)
        except OSError as error:
            path.unlink(missing_ok=True)
            os.close(descriptor)
            if error.errno in _NO_ROOM:
                raise _no_space(path.parent, name, size) from error
            raise

    @classmethod
    def attach(cls, name: str, *, writable: bool = False) -> Segment:
        """Map an existing segment; raises FrameLostError if it is gone."""
        _check_name(name)
        path = shm_folder() / name
        try:
            descriptor = os.open(path, os.O_RDWR if writable else os.O_RDONLY)
        except FileNotFoundError as error:
            raise FrameLostError(f"the segment {name} is gone: the process that owned it has ended") from error
        except PermissionError as error:
            raise FrameLostError(
                f"the segment {name} belongs to another user; run all services as the same one"
            ) from error
        size = os.fstat(descriptor).st_size
        if size == 0:
            os.close(descriptor)
            raise FrameLostError(f"the segment {name} is still empty; its owner has just begun, try again")
        try:
            return cls(name, descriptor, size, owned=False, writable=writable)
        except OSError:
            os.close(descriptor)
            raise

    def allocate(self, start: int, count: int) -> None:
        """Give ``count`` bytes from ``start`` their memory; raises NoSpaceError, or FrameLostError after ``close``."""
        if self._descriptor is None:
            raise FrameLostError(f"the segment {self.name} is closed")
        try:
            os.posix_fallocate(self._descriptor, start, count)
        except OSError as error:
            if error.errno in _NO_ROOM:
                raise _no_space(shm_folder(), self.name, count) from error
            raise

    @property
    def buffer(self) -> memoryview:
        """The mapped bytes; raises FrameLostError after ``close``."""
        if self._buffer is None:
            raise FrameLostError(f"the segment {self.name} is closed")
        return self._buffer

    @property
    def closed(self) -> bool:
        """Whether ``close`` was called."""
        return self._buffer is None

    @property
    def abandoned(self) -> bool:
        """Whether its file was removed, so that only who has it mapped keeps its memory; False after ``close``."""
        return self._descriptor is not None and os.fstat(self._descriptor).st_nlink == 0

    def close(self) -> None:
        """Unmap; the owner also removes the name. May be called again.

        An array that somebody still holds keeps its bytes mapped (and valid) until it is dropped: the
        mapping then ends with the last of them instead of here.
        """
        if self._buffer is None or self._descriptor is None:
            return
        if self._owned:
            (shm_folder() / self.name).unlink(missing_ok=True)
        buffer, self._buffer = self._buffer, None
        try:
            buffer.release()
            self._map.close()
        except BufferError:
            del buffer
            del self._map  # the arrays' own references keep the mapping until they go
        os.close(self._descriptor)
        self._descriptor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def sweep(prefix: str, owner: str | None = None) -> list[str]:
    """Remove the segments of dead processes; returns their names.

    Takes all whose names start with this prefix (and owner). A segment of a live process is never touched:
    its lock can't be taken. Those of another user are left alone.
    """
    return [path.name for path in _segments(prefix, owner) if _is_dead(path, remove=True)]


def dead_segments(prefix: str) -> list[str]:
    """The names of what ``sweep`` would remove."""
    return [path.name for path in _segments(prefix, None) if _is_dead(path, remove=False)]


def _segments(prefix: str, owner: str | None) -> list[Path]:
    start = f"tagmill-{prefix}-" if owner is None else f"tagmill-{prefix}-{owner}"
    folder = shm_folder()
    return sorted(path for path in folder.iterdir() if path.name.startswith(start)) if folder.is_dir() else []


def _is_dead(path: Path, *, remove: bool) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except (FileNotFoundError, PermissionError):
        return False
    try:
        if not _lock(descriptor) or os.fstat(descriptor).st_nlink == 0:
            return False
        if remove:
            path.unlink(missing_ok=True)
        return True
    finally:
        os.close(descriptor)


def _open_locked(path: Path) -> int:
    """Create a file and lock it; a sweep that comes between the two steps removes it, so look and try again."""
    for _ in range(_ATTEMPTS):
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except FileExistsError as error:
            raise NameTakenError(f"the segment {path} exists already; another process owns it") from error
        except OSError as error:
            if error.errno in _NO_ROOM:
                raise _no_space(path.parent, path.name, 0) from error
            raise
        if _lock(descriptor) and os.fstat(descriptor).st_nlink > 0:
            return descriptor
        os.close(descriptor)
    raise NameTakenError(f"the segment {path} was removed {_ATTEMPTS} times while it was being made")


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _check_name(name: str) -> None:
    # Names come in messages: nothing but a plain name may become a path.
    if not _NAME.match(name):
        raise FrameLostError(f"'{name}' is no name of a segment")


def _check_room(folder: Path, name: str, size: int) -> None:
    if not folder.is_dir():
        raise NoSpaceError(f"shared memory: the folder {folder} does not exist")
    if size > _free(folder)[0]:
        raise _no_space(folder, name, size)


def _free(folder: Path) -> tuple[int, int]:
    room = os.statvfs(folder)
    return room.f_bavail * room.f_frsize, room.f_blocks * room.f_frsize


def _no_space(folder: Path, name: str, size: int) -> NoSpaceError:
    free, total = _free(folder)
    wanted = -(-(total - free + size) // (_SHM_STEP_MB * _MEGABYTE)) * _SHM_STEP_MB
    return NoSpaceError(
        f"shared memory is full: {name} needs {size / _MEGABYTE:.1f} MB in {folder}, where "
        f"{free / _MEGABYTE:.1f} of {total / _MEGABYTE:.1f} MB are free; give it more (Docker: --shm-size={wanted}m or "
        "larger, every camera and every label process needs a ring) or lower ring.slots in the rig file"
    )
