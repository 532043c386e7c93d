"""Opening a session: its folders, its lock, the comparison with the rig, the recovery. Runs beside the loop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from common.clock import iso_utc, wall_ns
from common.config import Rig, differences
from common.dataset import LABELS, SESSION_FILE, SessionFile, StackLife, make_folder, read_session, write_bytes
from common.dataset.locks import FolderLock
from common.dataset.session import versions_now
from common.errors import RefusedError
from services.store.disk import require_room
from services.store.ledger import Book
from services.store.records import Records, summed
from services.store.recovery import Inventory, recover

SESSION_DIFFERS = "session_differs"
_ALWAYS = ("rgb", "depth", LABELS)


class SessionDiffersError(RefusedError):
    """The session on disk was recorded with another rig; ``differences`` holds one line each."""

    code = SESSION_DIFFERS

    def __init__(self, folder: Path, found: tuple[str, ...]) -> None:
        super().__init__(
            f"session {folder.name} in {folder.parent} was recorded with another rig: {'; '.join(found)}; "
            "put the rig back, or choose another session"
        )
        self.differences = found


@dataclass(frozen=True)
class Wanted:
    """Which session to open for which rig. ``new_if_different``: go on to name-2, name-3 ... where the rig differs."""

    root: Path
    name: str
    rig: Rig
    life: StackLife
    new_if_different: bool = False


@dataclass(frozen=True)
class OpenSession:
    """An open session, locked until ``lock`` is released."""

    folder: Path
    book: Book
    inventory: Inventory
    lock: FolderLock
    interrupted: tuple[str, ...]
    created: bool
    records: Records


def open_session(wanted: Wanted, reserve: int, held: OpenSession | None = None) -> OpenSession:
    """Open or continue a session, recovered and with its ``session.json`` on the disk.

    ``held`` is the session that is open now; it is returned as it is if it turns out to be the one wanted.

    Raises SessionDiffersError; RefusedError ``session_busy`` if another store writes to it and ``disk_full``;
    DatasetError if its files can't be read; OSError. Whatever fails, nothing of an existing session is changed.
    """
    for name in _names(wanted):
        try:
            return _open(wanted, wanted.root / name, reserve, held)
        except SessionDiffersError:
            if not wanted.new_if_different:
                raise
    raise AssertionError("the names never end")


def _names(wanted: Wanted) -> Iterator[str]:
    yield wanted.name
    yield from (f"{wanted.name}-{number}" for number in count(2))


def _open(wanted: Wanted, folder: Path, reserve: int, held: OpenSession | None) -> OpenSession:
    if held is not None and held.folder == folder:
        _require_same_rig(folder, held.book.rig, wanted.rig)
        return held
    make_folder(folder)
    lock = FolderLock(folder)
    try:
        return _open_locked(wanted, folder, lock, reserve)
    except BaseException:
        lock.release()
        raise


def _open_locked(wanted: Wanted, folder: Path, lock: FolderLock, reserve: int) -> OpenSession:
    known = read_session(folder) if (folder / SESSION_FILE).exists() else None
    if known is not None:
        _require_same_rig(folder, known.rig, wanted.rig)
    for name in _ALWAYS:
        make_folder(folder / name)
    with FolderLock(folder / LABELS):
        inventory = recover(folder)
    plain = wanted.rig.as_plain()
    file = known or SessionFile(name=folder.name, created_at=iso_utc(wall_ns()), rig=plain, versions=versions_now())
    records = Records(folder)
    file = _without_requests(file, records)
    open_counts = {recording: counts for recording, counts in inventory.recorded.items() if recording not in records}
    book = Book(file, open_counts, wanted.life, inventory.deleted)
    book.take_rig(plain)
    interrupted = book.close_earlier(wall_ns())
    snapshot = book.snapshot()  # also told otherwise by what was deleted without a stack, or just before a kill
    if snapshot != known:
        if known is None:
            require_room(folder, 0, reserve)
        write_bytes(folder / SESSION_FILE, snapshot.to_bytes())
    return OpenSession(folder, book, inventory, lock, interrupted, known is None, records)


def _without_requests(file: SessionFile, records: Records) -> SessionFile:
    """``session.json`` with the sums of the requests; those that an earlier tagmill kept in it itself move out."""
    over = {
        name: ledger
        for name, ledger in file.recordings.items()
        if ledger.spec.mode == "record" and ledger.phase in ("ended", "interrupted")
    }
    totals = records.totals
    for entry in records.append(over.values()):
        totals = summed(totals, entry)
    kept = {name: ledger for name, ledger in file.recordings.items() if name not in over}
    progress = {name: known for name, known in file.progress.items() if name in kept}
    return file.model_copy(update={"recordings": kept, "progress": progress, "records": totals})


def _require_same_rig(folder: Path, known: Mapping[str, Any], rig: Rig) -> None:
    found = tuple(differences(known, rig.as_plain()))
    if found:
        raise SessionDiffersError(folder, found)
