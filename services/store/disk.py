"""The disk under the dataset: how much room is left, and whether anything can be stored."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path

from common.dataset.faults import DISK_FULL, NO_DATASET, SENTENCES, explain
from common.errors import RefusedError
from common.messages import ErrorInfo

RESERVE_BYTES = 32 << 20
"""Kept free, so that ``session.json`` (the ledger) can be written when there is no room for a sample any more."""


@dataclass(frozen=True)
class DiskState:
    """What a look at the disk found: free bytes for this user, and why nothing can be stored (None = it can)."""

    free_bytes: int | None
    problem: ErrorInfo | None = None

    @property
    def gone(self) -> bool:
        """Whether the session's folder was taken away: nothing can be ended in it any more."""
        return self.problem is not None and self.problem.code == NO_DATASET


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
    return SENTENCES[DISK_FULL].format(
        folder=folder, detail=f"{free / 1e6:.0f} MB free, of which {reserve / 1e6:.0f} MB are kept for the ledger"
    )
