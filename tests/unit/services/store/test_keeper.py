"""The session keeper around a real disk thread."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from common import log
from common.bus import Poller
from common.config import load_rig
from common.dataset import StackLife, read_session
from common.ledgers import CameraLedger
from common.messages import ErrorInfo, LedgerOrder
from services.store import keeper as keeper_module
from services.store.background import Completions, DiskThread
from services.store.keeper import Phase, SessionKeeper
from services.store.sessions import Wanted
from tests.support.samples import START_NS, spec
from tests.support.stack import write_rig

DEADLINE_S = 20.0


class Loop:
    """A service's loop around a keeper with an open session."""

    def __init__(self, folder: Path) -> None:
        self.completions = Completions()
        self.disk = DiskThread(self.completions)
        self.keeper = SessionKeeper(self.disk, log.get(), reserve=0)
        self._rig = load_rig(write_rig(folder))
        opened: list[ErrorInfo | None] = []
        self.keeper.open(self.wanted("test"), opened.append)
        assert self.keeper.phase is Phase.OPENING
        self.run_until(lambda: bool(opened))
        assert (opened, self.keeper.phase) == ([None], Phase.OPEN)

    def run_until(self, done: Callable[[], bool]) -> None:
        poller = Poller(self.completions)
        deadline = time.monotonic() + DEADLINE_S
        while not done():
            assert time.monotonic() < deadline, "waited in vain"
            poller.wait(min(0.1, self.keeper.tick()))
            self.completions.run()

    def wanted(self, name: str) -> Wanted:
        return Wanted(self._rig.dataset_root, name, self._rig, StackLife(pid=1, started=1, machine_boot="a"))

    def account(self, captured: int) -> int:
        book = self.keeper.book
        assert book is not None
        order = LedgerOrder(key="k", spec=spec(), camera="cam0", account=CameraLedger(captured=captured))
        book.merge(order, START_NS)
        return book.revision


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[Loop]:
    made = Loop(tmp_path)
    yield made
    assert made.disk.close(5)
    made.keeper.close()
    made.completions.close()


def test_changes_are_answered_once_they_are_on_the_disk_many_with_one_write(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    writes: list[Path] = []
    write = keeper_module.write_bytes

    def spy(path: Path, data: bytes) -> None:
        write(path, data)
        writes.append(path)

    monkeypatch.setattr(keeper_module, "write_bytes", spy)
    answers: list[ErrorInfo | None] = []
    for captured in range(1, 21):
        loop.keeper.when_durable(loop.account(captured), answers.append)
    assert not loop.keeper.settled
    loop.run_until(lambda: len(answers) == 20)
    assert answers == [None] * 20
    assert len(writes) == 1
    assert read_session(writes[0].parent).recordings["rec-a"].cameras["cam0"].captured == 20
    assert loop.keeper.settled
    loop.keeper.when_durable(0, answers.append)
    assert len(answers) == 21


def test_a_change_that_can_not_be_written_is_told(loop: Loop) -> None:
    session = loop.keeper.session
    assert session is not None
    session.folder.rename(session.folder.with_name("away"))
    answers: list[ErrorInfo | None] = []
    loop.keeper.when_durable(loop.account(1), answers.append, urgent=True)
    loop.run_until(lambda: bool(answers))
    assert answers[0] is not None
    assert answers[0].code == "no_dataset"
    assert loop.keeper.settled, "a drain must not wait for a disk that is gone"
    session.folder.with_name("away").rename(session.folder)
    loop.keeper.when_durable(loop.account(2), answers.append, urgent=True)
    loop.run_until(lambda: len(answers) == 2)
    assert answers[1] is None


def test_what_could_not_be_written_is_tried_once_more_before_the_end(loop: Loop) -> None:
    session = loop.keeper.session
    assert session is not None
    assert not loop.keeper.tries_once_more(), "all is written"
    away = session.folder.with_name("away")
    session.folder.rename(away)
    answers: list[ErrorInfo | None] = []
    loop.keeper.when_durable(loop.account(1), answers.append, urgent=True)
    loop.run_until(lambda: bool(answers))
    away.rename(session.folder)
    assert loop.keeper.tries_once_more()
    assert not loop.keeper.settled
    loop.run_until(lambda: loop.keeper.settled)
    assert read_session(session.folder).recordings[spec().recording].cameras["cam0"].captured == 1
    session.folder.rename(away)
    loop.keeper.when_durable(loop.account(2), answers.append, urgent=True)
    loop.run_until(lambda: len(answers) == 2)
    assert not loop.keeper.tries_once_more(), "once is enough"
    assert loop.keeper.settled
    away.rename(session.folder)


def test_what_was_written_of_the_session_before_says_nothing_of_the_one_that_is_open_now(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeper_module, "_WRITE_EVERY_NS", 0)
    answers: list[ErrorInfo | None] = []
    loop.keeper.when_durable(loop.account(1), answers.append)
    loop.run_until(lambda: bool(answers))
    book = loop.keeper.book
    assert book is not None
    loop.keeper.open(loop.wanted("other"), answers.append)
    book.samples_moved({}, deleted=True)  # a move that was under way is told only now, and is written after the opening
    loop.run_until(lambda: len(answers) == 2 and loop.keeper.settled)
    loop.keeper.when_durable(loop.account(7), answers.append)
    loop.run_until(lambda: len(answers) == 3)
    session = loop.keeper.session
    assert session is not None
    assert (answers, session.folder.name) == ([None] * 3, "other")
    assert read_session(session.folder).recordings["rec-a"].cameras["cam0"].captured == 7


def test_a_disk_that_does_not_answer_is_told_without_waiting_for_it(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeper_module, "_STALLED_S", 0)
    loop.run_until(lambda: loop.keeper.disk.free_bytes is not None)
    assert loop.keeper.problem is None
    stuck = threading.Event()
    loop.disk.submit(lambda: stuck.wait(DEADLINE_S), lambda _: None)
    try:
        loop.run_until(lambda: loop.keeper.problem is not None)
        assert loop.keeper.problem is not None
        assert "has not answered" in loop.keeper.problem.message
        assert not loop.disk.close(0)
    finally:
        stuck.set()
