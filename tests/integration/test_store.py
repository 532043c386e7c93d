"""The real store process with real orders and real pixels: what it does when all is well."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus import Publisher
from common.dataset import SessionReader, read_session
from common.ids import new_boot
from common.ledgers import CameraLedger
from common.messages import CameraState
from common.topics import CAMERA
from tests.support.samples import StoreSide, camera_label, check_whole, label_for, spec
from tests.support.stack import RIG, ServiceProcess, Stack, write_rig

pytestmark = pytest.mark.process


@pytest.fixture
def label_side(stack: Stack) -> Iterator[StoreSide]:
    stack.endpoints.prepare()
    side = StoreSide(stack.endpoints)
    yield side
    side.close()


def start(stack: Stack, *arguments: str, rig: str = RIG, **environment: str) -> ServiceProcess:
    environment = {"TAGMILL_STORE_RESERVE_MB": "0", **environment}
    return stack.start_service("store", write_rig(stack.folder, rig), *arguments, **environment)


def session_of(stack: Stack, name: str = "test") -> Path:
    return stack.folder / "dataset" / name


def test_samples_are_on_the_disk_when_their_answer_comes(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    keys = [label_side.store(frame) for frame in range(1, 9)]
    for key in keys:
        assert label_side.answer_to(key).samples == (key,)
        SessionReader(session_of(stack)).verify(key)
    check_whole(session_of(stack), *keys)
    assert store.stop() == 0
    check_whole(session_of(stack), *keys)


def test_the_store_writes_its_own_sessions_name_and_the_original(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    with_original = StoreSide(stack.endpoints, with_original=True, identity="label.1")
    try:
        key = with_original.store(1)
        with_original.answer_to(key)
    finally:
        with_original.close()
    reader = SessionReader(session_of(stack))
    assert reader.label(key).session == "test"
    original = reader.original(key)
    assert original is not None
    assert (original == 255 - reader.colour(key)).all()


def test_a_repeat_is_answered_without_writing_again(stack: Stack, label_side: StoreSide) -> None:
    start(stack, TAGMILL_STORE_DELAY_MS="300")
    order = label_side.order(1)
    assert order is not None
    other = StoreSide(stack.endpoints, 2, identity="label.1")
    try:
        label_side.send(order)
        other.send(order)  # in flight: both get the answer, it is written once
        assert label_side.answer_to(order.key).samples == (order.key,)
        assert other.answer_to(order.key).samples == (order.key,)
        path = session_of(stack) / f"label/label_{order.key}.json"
        written = path.stat().st_mtime_ns
        other.answers.clear()
        other.send(order)  # long done: answered from the index
        assert other.answer_to(order.key).samples == (order.key,)
        assert path.stat().st_mtime_ns == written
    finally:
        other.close()
    check_whole(session_of(stack), order.key)


def test_a_restarted_store_answers_from_the_disk_even_without_pixels(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    order = label_side.order(1)
    assert order is not None
    label_side.answer_to(label_side.send(order))
    assert store.stop() == 0
    label_side.ring.close()
    start(stack)
    label_side.answers.clear()
    label_side._slots.clear()
    assert label_side.answer_to(label_side.send(order)).samples == (order.key,)
    lost = order.model_copy(update={"key": label_for(2).sample, "label": label_for(2)})
    assert label_side.error_of(label_side.send(lost)).code == "pixels_gone"


def test_an_order_that_contradicts_itself_or_is_garbage_changes_nothing(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    good = label_side.order(1)
    assert good is not None
    wrong = good.model_copy(update={"key": "../../../etc/passwd"})
    assert label_side.error_of(label_side.send(wrong)).code == "bad_sample"
    slot = good.model_copy(update={"key": label_for(2).sample, "label": label_for(2), "slot": 999})
    assert label_side.error_of(label_side.send(slot)).code == "pixels_gone"
    label_side.answers.clear()
    label_side.answer_to(label_side.send(good))
    check_whole(session_of(stack), good.key)


def test_the_ledger_is_durable_when_answered_and_counts_by_itself(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    for frame in range(1, 6):
        label_side.answer_to(label_side.store(frame))
    account = CameraLedger(captured=8, labelled=8, recorded=2, refused={"no_object": 2}, pending=3)
    (ledger,) = label_side.answer_to(label_side.ledger(spec(), account)).ledgers
    assert (ledger.cameras["cam0"].recorded, ledger.cameras["cam0"].pending) == (5, 0)
    assert read_session(session_of(stack)).recordings["rec-a"] == ledger
    assert label_side.query().ledgers == (ledger,)
    store.kill()

    store = start(stack)
    answer = label_side.query()
    assert answer.text == "test"
    assert answer.ledgers == (ledger,), "the same stack goes on with its recording"
    final = CameraLedger(captured=8, recorded=5, refused={"no_object": 2}, dropped={"label": 1})
    (ended,) = label_side.answer_to(label_side.ledger(spec(), final, ended=True)).ledgers
    assert ended.phase == "ended"
    assert ended.cameras["cam0"].settled
    assert read_session(session_of(stack)).recordings["rec-a"] == ended
    assert label_side.query().ledgers == ()
    assert label_side.query("rec-a").ledgers == (ended,)
    label_side.answers.clear()
    error = label_side.query("rec-x").error
    assert error is not None
    assert error.code == "no_recording"


def test_who_asks_for_all_ledgers_is_told_of_the_samples_that_are_under_way(
    stack: Stack, label_side: StoreSide
) -> None:
    start(stack, TAGMILL_STORE_DELAY_MS="200")
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=4, pending=4)))
    keys = [label_side.store(frame) for frame in range(1, 5)]
    (ledger,) = label_side.query().ledgers
    assert (ledger.cameras["cam0"].recorded, ledger.cameras["cam0"].pending) == (4, 0)
    check_whole(session_of(stack), *keys)


def test_single_requests_go_to_a_file_of_their_own(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    requests = [spec(f"rec-{number}").model_copy(update={"mode": "record"}) for number in range(40)]
    label_side.answer_to(label_side.store(1, recording="rec-7"))
    keys = [
        label_side.ledger(request, CameraLedger(captured=3, refused={"no_object": 2}, pending=1), ended=True)
        for request in requests
    ]
    for key in keys:
        assert label_side.answer_to(key).error is None
    assert label_side.answer_to(keys[7]).ledgers[0].cameras["cam0"].recorded == 1
    repeated = label_side.ledger(requests[7], CameraLedger(captured=3, refused={"no_object": 2}), ended=True)
    assert label_side.answer_to(repeated).error is None
    lines = session_of(stack) / "records.jsonl"
    assert len(lines.read_bytes().splitlines()) == 40
    assert label_side.session("test").text == "test", "and all is written"
    store.kill()
    with lines.open("ab") as file:
        file.write(b'{"spec": {"recording": "rec-torn"')

    start(stack)
    (found,) = label_side.query("rec-7").ledgers
    assert (found.phase, found.cameras["cam0"].recorded) == ("ended", 1)
    assert len(lines.read_bytes().splitlines()) == 40
    file = read_session(session_of(stack))
    assert file.recordings == {}
    assert (file.records["cam0"].captured, file.records["cam0"].refused) == (120, {"no_object": 80})
    assert label_side.query("rec-torn").error is not None


def test_a_recording_of_an_earlier_stack_is_closed_as_interrupted(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    label_side.answer_to(label_side.store(1))
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=3, pending=2)))
    store.kill()
    path = session_of(stack) / "session.json"
    plain = json.loads(path.read_text())
    plain["progress"]["rec-a"]["life"]["started"] -= 1  # as if another supervisord had been the parent
    path.write_text(json.dumps(plain))
    store = start(stack)
    assert label_side.query().ledgers == ()
    (ledger,) = label_side.query("rec-a").ledgers
    assert ledger.phase == "interrupted"
    assert ledger.cameras["cam0"].dropped == {"interrupted": 2}
    assert ledger.cameras["cam0"].settled
    assert store.wait_for_event("recording.interrupted")["recording"] == "rec-a"


def test_a_camera_is_in_the_session_before_its_first_sample_is_answered(stack: Stack, label_side: StoreSide) -> None:
    bus = stack.start_module("tests.support.bus_only", "--rig", str(write_rig(stack.folder)))
    bus.wait_for_event("service.opened")
    start(stack)
    listener = stack.listen()
    listener.wait_for_state("store")
    publisher = Publisher(stack.endpoints, "capture.cam1", new_boot())
    state = CameraState(
        boot="b",
        phase="streaming",
        driver="synthetic",
        ring="r",
        camera=camera_label("cam1"),
        fps=30,
        depth_unit_mm=0.25,
    )

    def told(received: object) -> bool:
        publisher.publish(CAMERA, ("cam1",), state)
        return "cam1" in getattr(getattr(received, "message", None), "cameras", ())

    try:
        listener.wait_for(told, why="the store to know cam1")
        assert "cam1" not in read_session(session_of(stack)).cameras
        label_side.answer_to(label_side.store(1, camera=camera_label("cam1")))
        (seen,) = read_session(session_of(stack)).cameras["cam1"]
        assert (seen.camera, seen.driver, seen.fps, seen.depth_unit_mm) == (camera_label("cam1"), "synthetic", 30, 0.25)

        moved = camera_label("cam1", focal_px=60.0)
        error = label_side.error_of(label_side.store(2, camera=moved))
        assert error.code == "session_differs"
        assert "camera cam1: matrix was" in error.message
        assert label_side.answer_to(label_side.store(3, camera=camera_label("cam1"))).error is None
        assert label_side.answer_to(label_side.store(3, camera=moved.model_copy(update={"name": "cam2"}))).error is None

        opening = state.model_copy(update={"camera": moved, "phase": "opening", "ring": ""})
        further = state.model_copy(update={"camera": camera_label("cam3")})

        def told_opening(received: object) -> bool:
            publisher.publish(CAMERA, ("cam1",), opening)
            publisher.publish(CAMERA, ("cam3",), further)
            return "cam3" in getattr(getattr(received, "message", None), "cameras", ())

        heard = listener.wait_for(told_opening, why="the store to know cam3, and so cam1's placeholder")
        assert heard.message.warnings == ()  # type: ignore[attr-defined]

        state = state.model_copy(update={"camera": moved})
        warned = listener.wait_for(
            lambda received: told(received) and bool(getattr(received.message, "warnings", ())), why="a warning"
        )
        assert warned.message.warnings[0].code == "session_differs"  # type: ignore[attr-defined]
    finally:
        publisher.close()


def test_another_rig_is_refused_until_another_session_is_opened(stack: Stack, label_side: StoreSide) -> None:
    start(stack).wait_for_event("session.opened")
    assert stack.processes[-1].stop() == 0
    other = RIG.replace("width: 400", "width: 410")
    store = start(stack, rig=other)
    assert store.wait_for_event("session.refused")["code"] == "session_differs"
    error = label_side.error_of(label_side.store(1))
    assert error.code == "session_differs"
    assert "objects.box-1.size_mm.width: 400 -> 410" in error.message
    key = label_side.ledger(spec(), CameraLedger(captured=1))
    assert label_side.error_of(key).code == "session_differs"
    again = label_side.session("test").error
    assert again is not None
    assert again.code == "session_differs"
    assert label_side.session("test", new_if_different=True).text == "test-2"
    done = label_side.store(2)
    assert label_side.answer_to(done).error is None
    check_whole(session_of(stack, "test-2"), done)
    assert not SessionReader(session_of(stack)).samples()


def test_asked_for_at_the_start_a_new_session_is_opened(stack: Stack, label_side: StoreSide) -> None:
    start(stack).wait_for_event("session.opened")
    assert stack.processes[-1].stop() == 0
    start(stack, "--new-session", rig=RIG.replace("width: 400", "width: 410"))
    assert label_side.query().text == "test-2"


def test_sessions_are_changed_without_a_restart_but_not_while_recording(stack: Stack, label_side: StoreSide) -> None:
    start(stack, TAGMILL_STORE_DELAY_MS="200")
    before = [label_side.store(frame) for frame in range(1, 5)]
    assert label_side.session("other").text == "other"
    after = label_side.store(9)
    label_side.answer_to(after)
    check_whole(session_of(stack), *before)
    check_whole(session_of(stack, "other"), after)
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=1)))
    refused = label_side.session("test").error
    assert refused is not None
    assert (refused.code, "rec-a is running" in refused.message) == ("wrong_state", True)
    assert label_side.session("other").text == "other"
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=1), ended=True))
    assert label_side.session("test").text == "test"
    bad = label_side.session("../escape").error
    assert bad is not None
    assert bad.code == "bad_name"


def test_a_killed_store_goes_on_in_the_session_that_was_chosen(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    assert label_side.session("other").text == "other"
    assert label_side.answer_to(label_side.store(1)).error is None
    store.kill()
    start(stack)
    sample = label_side.store(2)
    assert label_side.answer_to(sample).error is None
    assert label_side.query().text == "other"
    check_whole(session_of(stack, "other"), sample)


def test_reload_takes_over_what_is_no_difference(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    assert label_side.reload().text == "test"
    write_rig(stack.folder, RIG.replace("ring:", "  cam2: {driver: synthetic}\nring:"))
    assert label_side.reload().text == "test"
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(), ended=True))
    assert "cam2" in read_session(session_of(stack)).rig["cameras"]
    write_rig(stack.folder, RIG.replace("marker_size_mm: 100", "marker_size_mm: 90"))
    refused = label_side.reload().error
    assert refused is not None
    assert refused.code == "session_differs"
    write_rig(stack.folder, RIG.replace("marker: 1", "marker: 0"))
    broken = label_side.reload().error
    assert broken is not None
    assert broken.code == "bad_config"
    assert "rig.yaml:" in broken.message
    write_rig(
        stack.folder, RIG.replace("marker_size_mm: 100", "marker_size_mm: 90").replace("session: test", "session: b")
    )
    assert label_side.reload().text == "b"
    key = label_side.store(1)
    label_side.answer_to(key)
    check_whole(session_of(stack, "b"), key)


def test_a_drain_answers_what_was_taken(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack, TAGMILL_STORE_DELAY_MS="200")
    label_side.answer_to(label_side.store(1))
    keys = [label_side.store(frame) for frame in range(2, 10)]
    label_side.answer_to(keys[0])  # so all were taken
    store.send_signal(signal.SIGTERM)
    for key in keys:
        assert label_side.answer_to(key).samples == (key,)
    assert store.wait() == 0
    check_whole(session_of(stack), *keys)
