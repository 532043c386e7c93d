"""Keeps the session: opens it, writes ``session.json`` after each change, looks after the disk. Never blocks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from enum import Enum

from structlog.typing import FilteringBoundLogger

from common import clock
from common.dataset import FOLDERS, SESSION_FILE, write_bytes
from common.dataset.faults import DISK_ERROR, explain
from common.dataset.locks import SESSION_BUSY
from common.errors import RefusedError, TagmillError
from common.messages import ErrorInfo
from services.store.background import DiskThread
from services.store.disk import DiskState, look
from services.store.ledger import Book
from services.store.sessions import OpenSession, SessionDiffersError, Wanted, open_session

_SECOND = 1_000_000_000
_WRITE_EVERY_NS = _SECOND // 2
_LOOK_EVERY_NS = _SECOND
_RETRY_EVERY_NS = 2 * _SECOND
_BUSY_RETRY_NS = _SECOND // 5
_BUSY_LIMIT_NS = 10 * _SECOND
"""How long a killed store's last worker is waited for before orders are refused."""

_STALLED_S = 5
_WORKED_IN = tuple(folder for folder in FOLDERS if folder != "original")

Done = Callable[[ErrorInfo | None], None]


class Phase(Enum):
    """``opening``: orders wait; ``open``: orders are carried out; ``refusing``: no session, see ``refusal``."""

    OPENING = "opening"
    OPEN = "open"
    REFUSING = "refusing"


class SessionKeeper:
    """One session at a time. All callbacks come in the loop's thread, from ``Completions.run`` or ``tick``.

    ``refusal`` says why there is no session (phase ``refusing``), ``disk`` what the last look at the disk found.
    """

    def __init__(self, disk: DiskThread, log: FilteringBoundLogger, reserve: int) -> None:
        self._disk_thread, self._log, self._reserve = disk, log, reserve
        self.phase = Phase.REFUSING
        self.refusal: ErrorInfo | None = None
        self.disk = DiskState(None)
        self.session: OpenSession | None = None
        self.samples: set[str] = set()
        self.binned: set[str] = set()
        self._wanted: Wanted | None = None
        self._before: tuple[Wanted, ErrorInfo] | None = None
        self._opened_then: Done | None = None
        self._opening_since = 0
        self._attempt = 0
        self._retry_ns: int | None = None
        self._durable = 0
        self._waiters: list[tuple[int, Done]] = []
        self._urgent = self._writing = self._looking = False
        self._write_failed = self._tried_once_more = False
        self._next_write_ns = self._next_look_ns = self._look_began_ns = 0

    @property
    def book(self) -> Book | None:
        """The open session's book."""
        return None if self.session is None else self.session.book

    def require_session(self) -> OpenSession:
        """The open session; raises RefusedError with the reason why there is none."""
        if self.session is None:
            assert self.refusal is not None
            raise RefusedError(self.refusal.message, code=self.refusal.code)
        return self.session

    def has(self, sample: str) -> bool:
        """Whether a sample is durable in the open session, or was: in the bin, or removed from it for good."""
        if self.session is None:
            return False
        return sample in self.samples or sample in self.binned or sample in self.session.inventory.emptied

    @property
    def problem(self) -> ErrorInfo | None:
        """Why nothing can be stored now: no session, a fault of the disk, or one that doesn't answer."""
        found = self.refusal or self.disk.problem
        waited_s = (clock.monotonic_ns() - self._look_began_ns) / _SECOND if self._looking else 0.0
        if found is None and self.session is not None and waited_s > _STALLED_S:
            message = f"the disk of {self.session.folder} has not answered for more than {_STALLED_S} s; samples wait"
            return ErrorInfo(code=DISK_ERROR, message=message)
        return found

    @property
    def settled(self) -> bool:
        """Whether nobody waits for ``session.json``, and it is written (or can't be)."""
        if self._writing or self._waiters or self.phase is Phase.OPENING:
            return False
        return self.book is None or self.book.revision <= self._durable or self._write_failed

    def tries_once_more(self) -> bool:
        """Before the end, once: whether what could not be written is tried again; the disk may have room by now."""
        again = self._write_failed and not self._tried_once_more
        if again:
            self._tried_once_more, self._write_failed, self._next_write_ns = True, False, 0
        return again

    # --- opening ------------------------------------------------------------------------------------------

    def open(self, wanted: Wanted, then: Done) -> None:
        """Open a session instead of the present one, which stays open if that fails. Nothing may be in work.

        A present one whose folder was deleted is given up first, so that it can be opened anew.
        """
        if self.disk.gone:
            self.close()
        self._before = None if self._wanted is None or self.refusal is None else (self._wanted, self.refusal)
        self._wanted, self._opened_then = wanted, then
        self.phase = Phase.OPENING
        self._opening_since = clock.monotonic_ns()
        self._try_open()

    def _try_open(self) -> None:
        wanted, reserve, held = self._wanted, self._reserve, self.session
        assert wanted is not None
        self._retry_ns = None
        self._attempt += 1
        attempt = self._attempt
        self._disk_thread.submit(lambda: open_session(wanted, reserve, held), lambda done: self._opened(attempt, done))

    def _opened(self, attempt: int, done: Future[OpenSession]) -> None:
        if attempt != self._attempt:  # another session was asked for meanwhile
            if done.exception() is None and done.result() is not self.session:
                done.result().lock.release()
            return
        try:
            session = done.result()
        except TagmillError as error:
            self._not_opened(error, ErrorInfo(code=error.code, message=error.message))
        except OSError as error:
            assert self._wanted is not None
            self._not_opened(error, explain(error, self._wanted.root))
        else:
            self._take(session)

    def _take(self, session: OpenSession) -> None:
        self.phase, self.refusal, self._before = Phase.OPEN, None, None
        self._next_look_ns = 0
        if session is self.session:
            assert self._wanted is not None
            session.book.take_rig(self._wanted.rig.as_plain())
        else:
            self.close()
            self.phase, self.session = Phase.OPEN, session
            self.samples, self.binned = session.inventory.samples, session.inventory.binned
            self._durable, self._write_failed = session.book.revision, False
            self._tell(session)
        self._answer_opener(None)

    def _not_opened(self, error: Exception, info: ErrorInfo) -> None:
        now = clock.monotonic_ns()
        busy = info.code == SESSION_BUSY and now - self._opening_since < _BUSY_LIMIT_NS
        if busy and self.session is None:
            if info != self.refusal:
                self._log.warning("session.busy", reason=info.message)
            self._retry_ns, self.refusal = now + _BUSY_RETRY_NS, info
            return
        if self.session is not None:
            self.phase = Phase.OPEN
            self._answer_opener(info)
            return
        if self.phase is Phase.OPENING or info != self.refusal:
            self._log.error("session.refused", code=info.code, reason=info.message)
        # The disk may come back; another rig's session won't change by itself.
        self._retry_ns = None if isinstance(error, SessionDiffersError) else now + _RETRY_EVERY_NS
        self.phase = Phase.REFUSING
        if self._before is None:
            self.refusal = info
        else:  # somebody asked for another session in vain: go on waiting for the one that was wanted before
            self._wanted, self.refusal = self._before
            self._before, self._retry_ns = None, now + _RETRY_EVERY_NS
        self._answer_opener(info)

    def _answer_opener(self, error: ErrorInfo | None) -> None:
        then, self._opened_then = self._opened_then, None
        if then is not None:
            then(error)

    def _tell(self, session: OpenSession) -> None:
        found = session.inventory
        log = self._log.bind(session=session.folder.name)
        for event, names in (("recovery.settled", found.settled), ("recovery.removed", found.removed)):
            if names:
                log.warning(event, files=len(names), names=names[:20])
        if found.orphans:
            log.warning("recovery.left_alone", samples=found.orphans, why="too many pictures without a label")
        if found.damaged:
            log.warning("recovery.damaged", samples=len(found.damaged), names=found.damaged[:20])
        for recording in session.interrupted:
            log.warning("recording.interrupted", recording=recording)
        log.info("session.opened", folder=str(session.folder), new=session.created, samples=len(found.samples))

    # --- session.json -------------------------------------------------------------------------------------

    def when_durable(self, revision: int, then: Done, *, urgent: bool = False) -> None:
        """Call ``then`` once this revision of the book is on the disk, or with the reason why it isn't.

        ``urgent``: write now; else at most twice a second.
        """
        if revision <= self._durable:
            then(None)
            return
        self._waiters.append((revision, then))
        self._urgent |= urgent

    def _write(self) -> None:
        session = self.session
        assert session is not None
        revision, snapshot = session.book.revision, session.book.snapshot()
        self._writing, self._urgent = True, False
        path = session.folder / SESSION_FILE
        self._disk_thread.submit(
            lambda: write_bytes(path, snapshot.to_bytes()), lambda done: self._written(session, revision, done)
        )

    def _written(self, session: OpenSession, revision: int, done: Future[None]) -> None:
        self._writing = False
        if session is not self.session:  # another was opened meanwhile, whose revisions are counted anew
            return
        now = clock.monotonic_ns()
        try:
            done.result()
        except OSError as error:
            info = explain(error, session.folder)
            if not self._write_failed:  # label asks again every second, for each recording that can't be ended
                self._log.error("session.not_written", code=info.code, reason=info.message)
            self._next_write_ns, self._next_look_ns = now + _RETRY_EVERY_NS, 0
            self._write_failed = True
            waiters, self._waiters = self._waiters, []
            for _, then in waiters:
                then(info)
            return
        self._durable, self._write_failed = revision, False
        self._next_write_ns = now + _WRITE_EVERY_NS
        due = [then for wanted, then in self._waiters if wanted <= revision]
        self._waiters = [waiter for waiter in self._waiters if waiter[0] > revision]
        for then in due:
            then(None)

    # --- time ---------------------------------------------------------------------------------------------

    def tick(self) -> float:
        """Begin what is due; returns the seconds until something is due again."""
        now = clock.monotonic_ns()
        due = [now + _SECOND]
        if self._retry_ns is not None:
            if now >= self._retry_ns:
                self._try_open()
            else:
                due.append(self._retry_ns)
        if self.session is not None:
            due.append(self._tick_write(self.session.book, now))
            due.append(self._tick_look(self.session, now))
        return max(min(due) - now, 0) / _SECOND

    def _tick_write(self, book: Book, now: int) -> int:
        if self._writing or book.revision <= self._durable:
            return now + _SECOND
        if now < self._next_write_ns and not self._urgent:
            return self._next_write_ns
        self._write()
        return now + _SECOND

    def _tick_look(self, session: OpenSession, now: int) -> int:
        if self._looking or now < self._next_look_ns:
            return now + _SECOND if self._looking else self._next_look_ns
        self._looking, self._look_began_ns, self._next_look_ns = True, now, now + _LOOK_EVERY_NS
        folder, reserve = session.folder, self._reserve
        self._disk_thread.submit(lambda: look(folder, _WORKED_IN, reserve), self._looked)
        return now + _SECOND

    def _looked(self, done: Future[DiskState]) -> None:
        self._looking = False
        before, self.disk = self.disk, done.result()
        if self.disk.problem == before.problem:
            return
        if self.disk.problem is not None:
            self._log.error("disk.problem", code=self.disk.problem.code, reason=self.disk.problem.message)
        else:
            self._log.info("disk.usable", free_bytes=self.disk.free_bytes)

    def close(self) -> None:
        """Release the session; what is not written stays in the book. Idempotent."""
        if self.session is not None:
            self.session.lock.release()
        self.session, self.disk, self.phase = None, DiskState(None), Phase.REFUSING
