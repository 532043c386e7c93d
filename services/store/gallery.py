"""The samples of a session as people see them: the list, the bin, the newest one.

Moves are done by the disk thread, so in order with all that is written; the list is kept, and read at the opening, by a
thread of its own, so that neither samples nor the ledger ever wait for it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Literal, TypeVar

from common.bus import Return
from common.dataset import SESSION_FILE
from common.dataset.bin import bin_of, delete, no_sample, restore
from common.dataset.faults import explain
from common.dataset.head import recording_of
from common.dataset.layout import LABELS, PictureKind
from common.dataset.listing import SampleIndex, item_of_label
from common.errors import RefusedError, TagmillError
from common.ids import sample_camera
from common.labels import Label
from common.messages import Answer, ErrorInfo, ListOrder, MoveOrder, NewestOrder, SampleList
from services.store.accounts import Give
from services.store.background import DiskThread
from services.store.keeper import SessionKeeper
from services.store.sessions import OpenSession

T = TypeVar("T")
What = Literal["stored", "deleted", "restored"]
Tell = Callable[[str, What, tuple[str, ...]], None]

NOTHING_TO_UNDO = "nothing_to_undo"
UNKNOWN_SESSION = "unknown_session"


class Gallery:
    """The part of the order desk for samples that are stored. ``busy``: moves that wait for the disk thread.

    ``answer`` gives an answer; ``tell(session, what, samples)`` publishes the news.
    """

    def __init__(self, keeper: SessionKeeper, disk: DiskThread, reader: DiskThread, answer: Give, tell: Tell) -> None:
        self._keeper, self._disk, self._reader, self._answer, self._tell = keeper, disk, reader, answer, tell
        self._session: OpenSession | None = None
        self._index = SampleIndex(Path())
        self._stop = threading.Event()
        self._other: tuple[_State, SampleIndex] | None = None
        self.busy = 0

    def follow(self) -> None:
        """Once a round: read the samples of a session that has just been opened."""
        session = self._keeper.session
        if session is self._session:
            return
        self._stop.set()
        self._session = session
        if session is not None:
            self._stop = stop = threading.Event()
            self._index = index = SampleIndex(session.folder)
            self._reader.submit(lambda: index.build(stop.is_set), _raise_bugs)

    def close(self) -> None:
        """End a reading that is under way."""
        self._stop.set()

    def stored(self, label: Label, pictures: Mapping[PictureKind, str]) -> None:
        """A sample became durable, with ``pictures`` at these paths; none: it was on the disk already."""
        session = self._keeper.session
        if session is None:
            return
        if not pictures:
            self._changed(session, "stored", (label.sample,))
            return
        self.follow()
        self._index.add(item_of_label(label, pictures))  # its file needn't be read again
        self._tell(session.book.name, "stored", (label.sample,))

    # --- orders -------------------------------------------------------------------------------------------

    def move(self, return_: Return, order: MoveOrder) -> None:
        """Move samples to the bin or back; answered once that is durable. Raises RefusedError."""
        session = self._keeper.require_session()
        stored, binned = self._keeper.samples, self._keeper.binned
        if unknown := [sample for sample in order.samples if sample not in stored and sample not in binned]:
            raise no_sample(session.folder, unknown)
        self.busy += 1
        self._disk.submit(
            lambda: _moved(session.folder, order), lambda done: self._moved(return_, order, session, done)
        )

    def _moved(self, return_: Return, order: MoveOrder, session: OpenSession, done: Future[_Recordings]) -> None:
        self.busy -= 1
        try:
            moved = done.result()
        except (OSError, TagmillError) as error:
            self._answer(return_, Answer(key=order.key, error=_info(error, session.folder)))
            return
        deleted = order.to == "bin"
        source, target = session.inventory.samples, session.inventory.binned
        if not deleted:
            source, target = target, source
        source.difference_update(moved)
        target.update(moved)
        if moved:
            session.book.samples_moved(moved, deleted=deleted)
            if session is self._keeper.session:
                self._changed(session, "deleted" if deleted else "restored", tuple(moved))
        self._answer(return_, Answer(key=order.key, samples=tuple(dict.fromkeys(order.samples))))

    def _changed(self, session: OpenSession, what: What, samples: tuple[str, ...]) -> None:
        self.follow()
        index = self._index

        def refresh() -> None:
            for sample in samples:
                index.refresh(sample)

        self._reader.submit(refresh, _raise_bugs)
        self._tell(session.book.name, what, samples)

    def newest(self, return_: Return, order: NewestOrder) -> None:
        """Name the newest sample; raises RefusedError ``nothing_to_undo``."""
        session = self._keeper.require_session()
        for sample in sorted(self._keeper.samples, reverse=True):
            if order.camera in (None, sample_camera(sample)):
                self._answer(return_, Answer(key=order.key, samples=(sample,)))
                return
        of = "" if order.camera is None else f" of {order.camera}"
        raise RefusedError(f"session {session.book.name} has no sample{of}", code=NOTHING_TO_UNDO)

    def list(self, return_: Return, order: ListOrder, root: Path) -> None:
        """List samples of the open session, or of another below ``root``; raises RefusedError."""
        self.follow()  # what waited for the opening comes before the round's end
        session = self._keeper.session
        if order.session is None:
            session = self._keeper.require_session()
        index = self._index
        folder = root / order.session if order.session is not None else None

        def page() -> SampleList:
            here = folder is None or (session is not None and folder == session.folder)
            wanted = index if here or folder is None else self._read_other(folder)
            return wanted.page(order.filter, order.offset, order.limit)

        def listed(done: Future[SampleList]) -> None:
            try:
                answer = Answer(key=order.key, listed=done.result())
            except (OSError, TagmillError) as error:
                answer = Answer(key=order.key, error=_info(error, folder or root))
            self._answer(return_, answer)

        self._reader.submit(page, listed)

    def _read_other(self, folder: Path) -> SampleIndex:
        """In the reader's thread: another session, read again whenever its folders have changed since."""
        if not (folder / SESSION_FILE).is_file():
            raise RefusedError(f"there is no session {folder.name} in {folder.parent}", code=UNKNOWN_SESSION)
        state = _state_of(folder)
        if self._other is None or self._other[0] != state:
            index = SampleIndex(folder)
            index.build()
            self._other = state, index
        return self._other[1]


_Recordings = dict[str, str | None]
_State = tuple[Path, tuple[int, ...]]


def _moved(session: Path, order: MoveOrder) -> _Recordings:
    """In the disk thread: move; returns what was moved, each sample with its recording."""
    to_bin = order.to == "bin"
    moved = (delete if to_bin else restore)(session, order.samples)
    place = bin_of(session) if to_bin else session
    return {sample: recording_of(place, sample) for sample in moved}


def _state_of(folder: Path) -> _State:
    """Changes with each sample that comes or goes: a rename is a change of its folder."""
    folders = (folder / LABELS, bin_of(folder) / LABELS)
    return folder, tuple(each.stat().st_mtime_ns if each.is_dir() else 0 for each in folders)


def _info(error: OSError | TagmillError, folder: Path) -> ErrorInfo:
    if isinstance(error, OSError):
        return explain(error, folder)
    return ErrorInfo(code=error.code, message=error.message)


def _raise_bugs(done: Future[None]) -> None:
    try:
        done.result()
    except OSError:  # a disk that is gone: the keeper's looks tell it, and the session is opened anew
        return
