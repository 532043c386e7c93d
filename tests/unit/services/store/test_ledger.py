import os
from collections import Counter

import pytest

from common.dataset import SessionCamera, SessionFile, StackLife
from common.errors import RefusedError
from common.ledgers import CameraLedger, Ledger
from common.messages import LedgerOrder
from services.store.ledger import Book
from services.store.life import stack_life
from tests.support.samples import START_NS, camera_label, spec

LIFE = StackLife(pid=10, started=100, machine_boot="a")
EARLIER = StackLife(pid=10, started=50, machine_boot="a")


def new_book(file: SessionFile | None = None, recorded: dict | None = None, life: StackLife = LIFE) -> Book:
    file = file or SessionFile(name="s", created_at="x", rig={"cameras": {"cam0": {"fps": 30}}}, versions={})
    return Book(file, recorded or {}, life)


def order(
    account: CameraLedger,
    camera: str = "cam0",
    *,
    ended: bool = False,
    recording: str = "rec-a",
    cameras: tuple[str, ...] = ("cam0",),
    why: str | None = None,
) -> LedgerOrder:
    return LedgerOrder(key="k", spec=spec(recording, *cameras), camera=camera, account=account, ended=ended, why=why)


def test_an_account_opens_its_recording() -> None:
    book = new_book()
    ledger = book.merge(order(CameraLedger(captured=3, pending=3)), START_NS)
    assert (ledger.phase, ledger.cameras["cam0"].captured) == ("running", 3)
    assert book.running() == ("rec-a",)
    assert book.query(None) == book.query("rec-a") == (ledger,)
    assert book.snapshot().recordings == {"rec-a": ledger}
    assert book.snapshot().progress["rec-a"].life == LIFE


def test_a_recording_ends_when_each_camera_has() -> None:
    book = new_book()
    two = ("cam0", "cam1")
    book.merge(order(CameraLedger(captured=1), "cam0", ended=True, cameras=two, why="stopped"), START_NS)
    assert book.running() == ("rec-a",)
    ledger = book.merge(order(CameraLedger(captured=1), "cam1", ended=True, cameras=two), START_NS)
    assert (ledger.phase, ledger.ended_at, ledger.why) == ("ended", "2026-08-29T10:40:00.000Z", "stopped")
    assert book.running() == ()
    late = book.merge(order(CameraLedger(captured=2), "cam1", cameras=two), START_NS)
    assert (late.phase, late.cameras["cam1"].captured) == ("ended", 2)


def test_an_older_account_changes_no_number() -> None:
    book = new_book()
    book.merge(order(CameraLedger(captured=9, recorded=9)), START_NS)
    ledger = book.merge(order(CameraLedger(captured=4, recorded=4)), START_NS)
    assert ledger.cameras["cam0"].captured == 9


def test_the_stores_own_count_wins_where_it_is_ahead() -> None:
    book = new_book(recorded={"rec-a": Counter(cam0=5)})
    book.sample_stored("rec-a", "cam0")
    ledger = book.merge(order(CameraLedger(captured=8, recorded=4, pending=4)), START_NS)
    assert (ledger.cameras["cam0"].recorded, ledger.cameras["cam0"].pending) == (6, 2)
    assert book.snapshot().recordings["rec-a"] == ledger
    book.sample_stored("rec-a", "cam0")
    assert book.query("rec-a")[0].cameras["cam0"].recorded == 7


def test_the_account_wins_where_a_sample_was_shared() -> None:
    ledger = new_book().merge(order(CameraLedger(captured=1, recorded=1)), START_NS)
    assert ledger.cameras["cam0"].recorded == 1


def test_more_durable_samples_than_captured_frames_are_never_told() -> None:
    book = new_book(recorded={"rec-a": Counter(cam0=12, cam1=2)})
    ledger = book.merge(order(CameraLedger(captured=10, recorded=8, refused={"no_object": 1}, pending=1)), START_NS)
    assert ledger.cameras["cam0"].captured == 13
    assert ledger.cameras["cam0"].settled
    assert ledger.cameras["cam1"] == CameraLedger(captured=2, recorded=2)


def test_frames_the_account_had_not_heard_of_are_not_counted_again() -> None:
    book = new_book(recorded={"rec-a": Counter(cam0=12)})
    told = CameraLedger(captured=10, recorded=9, dropped={"detect": 1}, boot="b", last_count=40)
    account = book.merge(order(told), START_NS).cameras["cam0"]
    assert (account.captured, account.last_count) == (13, 43)
    assert account.settled


def test_a_sample_given_up_at_a_restart_of_label_is_not_counted_twice() -> None:
    book = new_book(recorded={"rec-a": Counter(cam0=8)})
    told = CameraLedger(captured=10, recorded=5, dropped={"label_restart": 4, "detect": 1}, boot="b", last_count=40)
    account = book.merge(order(told), START_NS).cameras["cam0"]
    assert (account.captured, account.recorded, account.last_count) == (10, 8, 40)
    assert account.dropped == {"label_restart": 1, "detect": 1}
    book.sample_stored("rec-a", "cam0")
    book.sample_stored("rec-a", "cam0")
    account = book.query("rec-a")[0].cameras["cam0"]
    assert (account.captured, account.recorded, account.last_count) == (11, 10, 41)
    assert account.dropped == {"detect": 1}
    assert account.settled


def test_a_late_sample_of_an_ended_recording_gets_to_the_disk() -> None:
    book = new_book()
    book.merge(order(CameraLedger(captured=1), ended=True), START_NS)
    revision = book.revision
    book.sample_stored("rec-a", "cam0")
    book.sample_stored(None, "cam0")
    assert book.revision == revision + 1
    assert book.query("rec-a")[0].cameras["cam0"].recorded == 1


def test_an_earlier_lifes_recordings_are_closed_and_settled() -> None:
    first = new_book(life=EARLIER)
    account = CameraLedger(captured=10, recorded=3, refused={"no_object": 2}, dropped={"detect": 1}, pending=4)
    first.merge(order(account), START_NS)
    first.merge(order(CameraLedger(captured=2, recorded=2), recording="rec-done", ended=True), START_NS)
    second = new_book(first.snapshot(), {"rec-a": Counter(cam0=5)})
    assert second.close_earlier(START_NS) == ("rec-a",)
    ledger = second.query("rec-a")[0]
    closed = ledger.cameras["cam0"]
    assert (ledger.phase, ledger.why) == ("interrupted", "the stack ended before the recording did")
    assert (closed.recorded, closed.pending, closed.dropped) == (5, 0, {"detect": 1, "interrupted": 2})
    assert closed.settled
    assert second.query("rec-done")[0].phase == "ended"
    assert second.running() == ()


def test_this_lifes_recordings_go_on_after_a_restart_of_the_store() -> None:
    first = new_book()
    first.merge(order(CameraLedger(captured=10)), START_NS)
    second = new_book(first.snapshot())
    assert second.close_earlier(START_NS) == ()
    assert second.revision == 0
    assert second.running() == ("rec-a",)


def test_a_recording_without_a_known_life_is_an_earlier_ones() -> None:
    ledger = Ledger(spec=spec(), phase="finishing", cameras={})
    file = SessionFile(name="s", created_at="x", rig={}, versions={}, recordings={"rec-a": ledger})
    assert new_book(file).close_earlier(START_NS) == ("rec-a",)


def test_an_unknown_recording_is_refused() -> None:
    with pytest.raises(RefusedError, match="session s has no recording 'rec-x'") as caught:
        new_book().query("rec-x")
    assert caught.value.code == "no_recording"


def test_cameras_are_learnt_once() -> None:
    book = new_book()
    seen = SessionCamera(since="t0", camera=camera_label(), depth_unit_mm=0.25)
    first = book.meet_camera(seen)
    assert first == book.revision == 1
    assert book.meet_camera(seen.model_copy(update={"since": "t1", "driver": "synthetic"})) == 1
    assert book.meet_camera(seen.model_copy(update={"since": "t2", "depth_unit_mm": 1.0})) == 2
    assert [entry.since for entry in book.snapshot().cameras["cam0"]] == ["t0", "t2"]
    assert new_book(book.snapshot()).meet_camera(book.snapshot().cameras["cam0"][-1]) == 0


def test_a_changed_calibration_is_a_difference_and_a_new_camera_is_none() -> None:
    book = new_book()
    book.meet_camera(SessionCamera(since="t0", camera=camera_label()))
    assert book.camera_differences(camera_label()) == ()
    assert book.camera_differences(camera_label("cam1")) == ()
    assert book.camera_differences(camera_label().model_copy(update={"serial": "other"})) == ()
    (told,) = book.camera_differences(camera_label(focal_px=51.0))
    assert told.startswith("camera cam0: matrix was ((50.0,")
    (told,) = book.camera_differences(camera_label(width=128, height=96))
    assert told.startswith("camera cam0 gives pictures of 128x96 now, and this session has it with "), told


def test_a_rigs_new_cameras_are_appended_and_absent_ones_stay() -> None:
    book = new_book()
    book.take_rig({"objects": {}, "cameras": {"cam1": {"fps": 10}}})
    assert book.rig == {"objects": {}, "cameras": {"cam0": {"fps": 30}, "cam1": {"fps": 10}}}
    revision = book.revision
    book.take_rig({"objects": {}, "cameras": {"cam1": {"fps": 10}}})
    assert book.revision == revision


def test_the_life_is_the_parents() -> None:
    assert stack_life() == stack_life()
    assert stack_life(os.getpid()) != stack_life()
    assert stack_life(1).pid == 1
