"""The disk under the dataset: how much room is left, and what an error of it means to the operator."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path

from common.errors import RefusedError
from common.messages import ErrorInfo

DISK_FULL = "disk_full"
READ_ONLY = "read_only"
NO_DATASET = "no_dataset"
DISK_ERROR = "disk_error"

RESERVE_BYTES = 32 << 20
"""Kept free, so that ``session.json`` (the ledger) can be written when there is no room for a sample any more."""

_MEANING = {
    errno.ENOSPC: DISK_FULL,
    errno.EDQUOT: DISK_FULL,
    errno.EFBIG: DISK_FULL,
    errno.EROFS: READ_ONLY,
    errno.EACCES: READ_ONLY,
    errno.EPERM: READ_ONLY,
    errno.ENOENT: NO_DATASET,
    errno.ENOTDIR: NO_DATASET,
    errno.ESTALE: NO_DATASET,
}
_SENTENCES = {
    DISK_FULL: "the disk of {folder} is full ({detail}); free some space there or move the dataset (dataset.root)",
    READ_ONLY: "{folder} can't be written ({detail}); remount the disk writable or correct the folder's permissions",
    NO_DATASET: "{folder} is not there any more ({detail}); bring the folder or its disk back, or open another session",
    DISK_ERROR: "writing to {folder} failed ({detail}); the disk may be broken, see the kernel's log",
}


@dataclass(frozen=True)
class DiskState:
    """What a look at the disk found: free bytes for this user, and why nothing can be stored (None = it can)."""

    free_bytes: int | None
    problem: ErrorInfo | None = None


def explain(error: OSError, folder: Path) -> ErrorInfo:
    """The refusal for an error of the operating system: a code and one sentence."""
    code = _MEANING.get(error.errno or 0, DISK_ERROR)
    return ErrorInfo(code=code, message=_SENTENCES[code].format(folder=folder, detail=error.strerror or error))


def free_bytes(folder: Path) -> int:
    """Bytes that this user may still write; raises OSError."""
    room = os.statvfs(folder)
    return room.f_bavail * room.f_frsize


def require_room(folder: Path, wanted: int, reserve: int) -> None:
    """Raise RefusedError (``disk_full``) if ``wanted`` bytes don't fit without touching the reserve."""
    free = free_bytes(folder)
    if free - wanted < reserve:
        raise RefusedError(_no_room(folder, free, reserve), code=DISK_FULL)


def look(folder: Path, needed: tuple[str, ...], reserve: int) -> DiskState:
    """Look at a session's folder and the folders ``needed`` in it. May block as long as the disk does."""
    try:
        room = os.statvfs(folder)
        for name in needed:
            (folder / name).stat()
    except OSError as error:
        return DiskState(None, explain(error, folder))
    free = room.f_bavail * room.f_frsize
    if room.f_flag & os.ST_RDONLY:
        return DiskState(free, explain(OSError(errno.EROFS, os.strerror(errno.EROFS)), folder))
    if free < reserve:
        return DiskState(free, ErrorInfo(code=DISK_FULL, message=_no_room(folder, free, reserve)))
    return DiskState(free)


def _no_room(folder: Path, free: int, reserve: int) -> str:
    return _SENTENCES[DISK_FULL].format(
        folder=folder, detail=f"{free / 1e6:.0f} MB free, of which {reserve / 1e6:.0f} MB are kept for the ledger"
    )
