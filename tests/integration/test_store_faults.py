"""The real store process when things go wrong: kills, full, read-only, deleted and stalled disks."""

from __future__ import annotations

import random
import resource
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from common.dataset import SessionReader, read_session
from common.ledgers import CameraLedger
from common.messages import ServiceState
from tests.support.mounts import make_read_only, small_disk
from tests.support.samples import StoreSide, check_whole, label_for, pixels, spec
from tests.support.stack import Listener, ServiceProcess, Stack, wait_for, write_rig

pytestmark = pytest.mark.process

KILLS = 10


@pytest.fixture
def label_side(stack: Stack) -> Iterator[StoreSide]:
    stack.endpoints.prepare()
    side = StoreSide(stack.endpoints)
    yield side
    side.close()


@pytest.fixture
def listener(stack: Stack) -> Listener:
    """Heartbeats, over a bus of the test's own."""
    bus = stack.start_module("tests.support.bus_only", "--rig", str(write_rig(stack.folder)))
    bus.wait_for_event("service.opened")
    return stack.listen()


def start(stack: Stack, *arguments: str, reserve_mb: str = "0", **environment: str) -> ServiceProcess:
    environment["TAGMILL_STORE_RESERVE_MB"] = reserve_mb
    return stack.start_service("store", write_rig(stack.folder), *arguments, **environment)


def session_of(stack: Stack) -> Path:
    return stack.folder / "dataset" / "test"


def workers_of(store: ServiceProcess) -> list[psutil.Process]:
    """The worker processes (not multiprocessing's own helper)."""
    children = psutil.Process(store.pid).children()
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def wait_for_fault(listener: Listener, said: str) -> ServiceState:
    while True:
        state = listener.wait_for_state("store", "faulty")
        if said in (state.last_error or ""):
            return state


class Recorder:
    """Keeps the store busy with orders, and resends to each new life of it as the label process does."""

    def __init__(self, side: StoreSide, listener: Listener) -> None:
        self.side, self.listener = side, listener
        self.ordered: list[str] = []
        self.frame = 0

    @property
    def acknowledged(self) -> set[str]:
        return {key for key in self.ordered if key in self.side.answers}

    def round(self) -> None:
        while (order := self.side.order(self.frame + 1)) is not None:
            self.frame += 1
            self.ordered.append(self.side.send(order))
        self.settle_round()

    def settle_round(self) -> None:
        for received in self.listener.subscriber.receive():
            state = received.message
            if isinstance(state, ServiceState) and state.service == "store":
                self.side.client.peer_seen(state.boot)
        self.side.receive(0.02)


def test_kill_9_at_any_moment_loses_nothing_that_was_acknowledged(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    moments = random.Random(20260830)
    recorder = Recorder(label_side, listener)
    cut_off = 0
    for number in range(KILLS):
        store = start(stack)
        if number % 3:  # killed in full swing; every third somewhere in its start
            before, limit = len(recorder.acknowledged), time.monotonic() + 30
            while len(recorder.acknowledged) == before:
                assert time.monotonic() < limit, "a restarted store gives no answer"
                recorder.round()
        alive_until = time.monotonic() + (moments.uniform(0, 0.3) if number % 3 else moments.uniform(0.2, 1.2))
        while time.monotonic() < alive_until:
            recorder.round()
        store.kill()
        cut_off += number % 3 > 0 and len(recorder.acknowledged) < len(recorder.ordered)
        reader = SessionReader(session_of(stack)) if recorder.acknowledged else None
        for key in recorder.acknowledged:
            assert reader is not None
            reader.verify(key)
    store = start(stack)
    deadline = time.monotonic() + 30
    while len(recorder.acknowledged) < len(recorder.ordered):
        assert time.monotonic() < deadline, "an order got no answer"
        recorder.settle_round()
    assert store.stop() == 0
    refused = {key: label_side.answers[key].error for key in recorder.ordered if label_side.answers[key].error}
    assert refused == {}
    assert cut_off >= KILLS // 2, "the kills must have met a busy store"
    check_whole(session_of(stack), *recorder.ordered)
    assert len(SessionReader(session_of(stack)).samples()) == len(recorder.ordered)


def test_a_restart_tells_what_it_removed_and_keeps_the_count(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    keys = [label_side.store(frame) for frame in (1, 2, 3)]
    for key in keys:
        label_side.answer_to(key)
    label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=4, recorded=1, pending=3)))
    store.kill()
    half = session_of(stack) / f"rgb/rgb_{label_for(9).sample}.png"
    half.write_bytes(b"half")
    store = start(stack)
    assert store.wait_for_event("recovery.removed")["names"] == [str(half.relative_to(session_of(stack)))]
    assert label_side.query().ledgers[0].cameras["cam0"].recorded == 3
    check_whole(session_of(stack), *keys)


def test_a_killed_worker_costs_nothing(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack, TAGMILL_STORE_DELAY_MS="100")
    label_side.answer_to(label_side.store(1))
    keys = [label_side.store(frame) for frame in range(2, 12)]
    label_side.answer_to(keys[0])
    wait_for(lambda: workers_of(store), why="workers")[0].kill()
    for key in keys:
        assert label_side.answer_to(key).error is None
    assert store.stop() == 0
    assert store.events("worker.died")
    check_whole(session_of(stack), *keys)


def test_workers_end_with_a_killed_store(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack, TAGMILL_STORE_DELAY_MS="60000")
    for frame in range(1, 4):
        label_side.store(frame)  # one is written, one is next, and the third calls for another worker

    def two() -> list[psutil.Process] | None:
        label_side.receive()
        return found if len(found := workers_of(store)) == 2 else None

    workers = wait_for(two, why="two workers")
    wait_for(lambda: all(worker.nice() > 0 for worker in workers), why="niced workers")
    store.kill()
    assert psutil.wait_procs(workers, timeout=10)[1] == []
    start(stack).wait_for_event("session.opened")


def test_a_stopped_store_answers_when_it_goes_on(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    label_side.answer_to(label_side.store(1))
    store.send_signal(signal.SIGSTOP)
    keys = [label_side.store(frame) for frame in range(2, 8)]
    label_side.receive(0.5)
    assert not set(keys) & set(label_side.answers)
    store.send_signal(signal.SIGCONT)
    for key in keys:
        assert label_side.answer_to(key).error is None
    check_whole(session_of(stack), *keys)


def test_a_slow_disk_does_not_stall_the_stores_loop(stack: Stack, label_side: StoreSide, listener: Listener) -> None:
    start(stack, TAGMILL_STORE_DELAY_MS="4000")
    assert label_side.query().text == "test"
    key = label_side.store(1)
    state = listener.wait_for_state("store")
    while not state.numbers["backlog"]:
        state = listener.wait_for_state("store")
    assert listener.wait_for_state("store").numbers["backlog"] == 1, "its heart beats while the disk is slow"
    assert key not in label_side.answers
    label_side.answer_to(key)


def test_a_full_disk_refuses_and_takes_samples_again_once_there_is_room(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    with small_disk(stack.folder / "dataset", 2) as disk:
        store = start(stack, reserve_mb="0.8")
        stored, frame = [], 0
        while True:
            frame += 1
            key = label_side.store(frame)
            if label_side.answer_to(key).error is not None:
                break
            stored.append(key)
        error = label_side.error_of(key)
        assert error.code == "disk_full"
        assert "kept for the ledger" in error.message
        assert len(stored) > 10
        check_whole(session_of(stack), *stored)
        label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=frame), ended=True))
        assert read_session(session_of(stack)).recordings["rec-a"].cameras["cam0"].recorded == len(stored)

        (disk / "filler").write_bytes(bytes(100_000))
        state = wait_for_fault(listener, "is full")
        assert state.dropped["disk_full"] == 1
        assert state.texts == {"session": "test", "problem": "disk_full"}
        (disk / "filler").unlink()
        shutil.rmtree(session_of(stack) / "depth")  # makes room, and is a fault of its own
        (session_of(stack) / "depth").mkdir()
        listener.wait_for_state("store", "running")
        again = label_side.store(frame + 1)
        assert label_side.answer_to(again).error is None
        SessionReader(session_of(stack)).verify(again)
        assert store.stop() == 0


def test_a_disk_that_fills_in_the_middle_of_a_sample_leaves_no_half(stack: Stack, label_side: StoreSide) -> None:
    with small_disk(stack.folder / "dataset", 1) as disk:
        store = start(stack)
        first = label_side.store(1)
        label_side.answer_to(first)
        free_kb = (shutil.disk_usage(disk).free - 12_000) // 1000  # room for one picture, not for two
        (disk / "filler").write_bytes(bytes(free_kb * 1000))
        refused = label_side.store(2)
        assert label_side.error_of(refused).code == "disk_full"
        check_whole(session_of(stack), first)
        (disk / "filler").unlink()
        third = label_side.store(3)
        assert label_side.answer_to(third).error is None
        check_whole(session_of(stack), first, third)
        assert store.stop() == 0


def test_a_write_that_fails_in_the_middle_of_a_file_leaves_no_half(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    first = label_side.store(1)
    label_side.answer_to(first)
    limits: dict[int, tuple[int, int]] = {}
    for worker in workers_of(store):
        limits[worker.pid] = resource.prlimit(worker.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(worker.pid, resource.RLIMIT_FSIZE, (4096, limits[worker.pid][1]))
    assert label_side.error_of(label_side.store(2)).code == "disk_full"
    check_whole(session_of(stack), first)
    for pid, limit in limits.items():
        resource.prlimit(pid, resource.RLIMIT_FSIZE, limit)
    assert label_side.answer_to(label_side.store(3)).error is None


def test_a_read_only_disk_refuses_and_is_used_again_when_writable(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    with small_disk(stack.folder / "dataset", 2) as disk:
        store = start(stack)
        first = label_side.store(1)
        label_side.answer_to(first)
        make_read_only(disk)
        error = label_side.error_of(label_side.store(2))
        assert error.code == "read_only"
        assert str(session_of(stack)) in error.message
        key = label_side.ledger(spec(), CameraLedger(captured=2), ended=True)
        assert label_side.error_of(key).code == "read_only"
        wait_for_fault(listener, "can't be written")
        make_read_only(disk, read_only=False)
        listener.wait_for_state("store", "running")
        third = label_side.store(3)
        assert label_side.answer_to(third).error is None
        key = label_side.ledger(spec(), CameraLedger(captured=3), ended=True)
        assert label_side.answer_to(key).ledgers[0].cameras["cam0"].recorded == 2
        check_whole(session_of(stack), first, third)
        assert store.stop() == 0


def test_a_disk_that_is_read_only_at_the_start_is_waited_for(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    with small_disk(stack.folder / "dataset", 2) as disk:
        make_read_only(disk)
        store = start(stack)
        assert label_side.error_of(label_side.store(1)).code == "read_only"
        wait_for_fault(listener, "can't be written")
        make_read_only(disk, read_only=False)
        listener.wait_for_state("store", "running")
        assert label_side.answer_to(label_side.store(2)).error is None
        assert store.stop() == 0


def test_a_deleted_session_is_refused_until_it_is_opened_again(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    start(stack)
    label_side.answer_to(label_side.store(1))
    shutil.rmtree(session_of(stack))
    error = label_side.error_of(label_side.store(2))
    assert error.code == "no_dataset"
    assert "is not there any more" in error.message
    wait_for_fault(listener, "is not there any more")
    assert not session_of(stack).exists(), "the store must not make a folder on what may be another disk"
    assert label_side.session("test").text == "test"
    listener.wait_for_state("store", "running")
    third = label_side.store(3)
    assert label_side.answer_to(third).error is None
    check_whole(session_of(stack), third)


def test_a_recording_goes_on_in_another_session_where_its_own_is_gone(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    store = start(stack)
    label_side.answer_to(label_side.store(1))
    assert label_side.answer_to(label_side.ledger(spec(), CameraLedger(captured=2, recorded=1))).error is None
    refused = label_side.session("tuesday").error
    assert refused is not None
    assert refused.code == "wrong_state", "as long as it could be ended"
    shutil.rmtree(session_of(stack))
    wait_for_fault(listener, "is not there any more")
    for captured in (3, 4, 5):
        key = label_side.ledger(spec(), CameraLedger(captured=captured, recorded=1), ended=True)
        assert label_side.error_of(key).code == "no_dataset"
    assert len(store.events("session.not_written")) == 1, "said once, not at each attempt"
    assert label_side.session("tuesday").text == "tuesday"
    answer = label_side.answer_to(
        label_side.ledger(spec(), CameraLedger(captured=5, recorded=1, refused={"no_dataset": 4}), ended=True)
    )
    assert answer.ledgers[0].phase == "ended"
    listener.wait_for_state("store", "running")


def test_a_late_repeat_of_a_refused_order_is_not_written_with_other_pixels(stack: Stack, label_side: StoreSide) -> None:
    start(stack)
    label_side.answer_to(label_side.store(1))
    away = stack.folder / "away"
    session_of(stack).rename(away)
    refused = label_side.order(2)
    assert refused is not None
    label_side.answer_to(label_side.send(refused))
    away.rename(session_of(stack))
    label_side.ring._taken.add(refused.slot)  # the slot was given back and holds frame 3 by now
    label_side.ring.view(refused.slot).bgr[:] = pixels(3)[0]
    label_side.answers.clear()
    assert label_side.error_of(label_side.send(refused)).code == "no_dataset"
    assert SessionReader(session_of(stack)).samples() == (label_for(1).sample,)


def test_a_dead_label_processs_orders_are_finished_or_named(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack, TAGMILL_STORE_DELAY_MS="300")
    label_side.answer_to(label_side.store(1))  # the workers may have the ring mapped or not; both are right
    keys = [label_side.store(frame) for frame in range(2, 8)]
    label_side.answer_to(keys[0])
    label_side.ring.close()
    label_side._slots.clear()
    for key in keys:
        error = label_side.answer_to(key).error
        assert error is None or error.code == "pixels_gone"
    assert store.stop() == 0
    check_whole(session_of(stack), *(key for key in keys if label_side.answers[key].error is None))


def test_two_stacks_do_not_write_one_session(stack: Stack, label_side: StoreSide) -> None:
    first = start(stack)
    first.wait_for_event("session.opened")
    second = start(stack, TAGMILL_PREFIX=f"{stack.place.prefix}b")
    assert "another tagmill" in second.wait_for_event("session.busy")["reason"]
    key = label_side.store(1)
    assert label_side.answer_to(key).error is None
    assert first.stop() == 0
    second.wait_for_event("session.opened")
    assert second.stop() == 0
    check_whole(session_of(stack), key)


@pytest.mark.parametrize("damage", ["{", '{"schema": "tagmill.session/99"}'])
def test_a_session_file_that_can_not_be_read_is_kept_and_said(stack: Stack, label_side: StoreSide, damage: str) -> None:
    session_of(stack).mkdir(parents=True)
    (session_of(stack) / "session.json").write_text(damage)
    start(stack)
    error = label_side.error_of(label_side.store(1))
    assert "session.json" in error.message
    assert (session_of(stack) / "session.json").read_text() == damage
    assert label_side.session("fresh").text == "fresh"


def test_an_idle_store_uses_no_cpu(stack: Stack, label_side: StoreSide) -> None:
    store = start(stack)
    label_side.answer_to(label_side.store(1))
    before = store.cpu_s()
    label_side.receive(3.0)
    assert store.cpu_s() - before < 0.02 * 3 + 0.05


def test_asking_for_a_second_session_in_vain_does_not_give_up_the_first(
    stack: Stack, label_side: StoreSide, listener: Listener
) -> None:
    broken = session_of(stack).with_name("broken")
    for folder in (session_of(stack), broken):
        folder.mkdir(parents=True)
        (folder / "session.json").write_text("{")
    start(stack)
    wait_for_fault(listener, "test/session.json")
    refused = label_side.session("broken").error
    assert refused is not None
    assert "broken/session.json" in refused.message
    wait_for_fault(listener, "test/session.json")
    (session_of(stack) / "session.json").unlink()
    listener.wait_for_state("store", "running")
    assert label_side.query().text == "test"
