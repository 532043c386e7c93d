"""A camera never stalls, not for a slow label process, not for a stopped store; and no order is left in silence."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from common.bus import CommandClient, Endpoints, Subscriber
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from common.errors import TagmillError
from common.topics import CAMERA
from common.words import words_for
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, NO_PAGE, SupervisedStack, check_session, supervised
from tools.bench.load_counter import CameraLoad, LoadCounter

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]

CAMERAS = ("cam0", "cam1")
SLOW_LABEL = {"TAGMILL_LABEL_DELAY_MS": "500"}
ORDER_TIMEOUT_S = 2.0


@dataclass
class Orders:
    """Gives record orders all the while, in a thread; every answer, and the silences."""

    answers: list[dict[str, Any]] = field(default_factory=list)
    silences: list[str] = field(default_factory=list)
    given: int = 0
    _over: threading.Event = field(default_factory=threading.Event)

    def give(self) -> None:
        with CommandClient(Endpoints.of(NetworkConfig())) as client:
            while not self._over.is_set():
                camera = (*CAMERAS, "all")[self.given % 3]
                self.given += 1
                request = {"command": "record", "camera": camera, "timeout_s": ORDER_TIMEOUT_S}
                try:
                    self.answers.append(client.request(request, timeout_s=DEADLINE_S))
                except TagmillError as error:
                    self.silences.append(error.message)

    @contextmanager
    def while_here(self) -> Iterator[Orders]:
        thread = threading.Thread(target=self.give, name="orders")
        thread.start()
        try:
            yield self
        finally:
            self._over.set()
            thread.join(2 * DEADLINE_S)
            assert not thread.is_alive()


def write_rig(folder: Path, size: tuple[int, int], fps: int) -> Path:
    width, height = size
    cameras = "\n".join(
        f"  {name}: {{driver: synthetic, width: {width}, height: {height}, fps: {fps}, seed: {number}, prerendered: 8}}"
        for number, name in enumerate(CAMERAS)
    )
    path = folder / "rig.yaml"
    # Two seconds of pictures: a frame that waits for two slow labels before it is taken must still be there.
    ring = f"ring: {{slots: {2 * fps}}}"
    path.write_text(f"dataset: {{root: ./dataset, session: stalls}}\n{NO_PAGE}\n{ring}\ncameras:\n{cameras}\n")
    return path


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """SIGSTOP, and SIGCONT after the block."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def count(stack: SupervisedStack, fps: int, seconds: float) -> dict[str, CameraLoad]:
    """Both cameras over that time; frames that nobody looks at count as well."""
    subscriber = Subscriber(Endpoints.of(NetworkConfig()))
    try:
        subscriber.subscribe(CAMERA)
        counter = LoadCounter(subscriber, fps)
        counter.listen(seconds)
        return counter.result()
    finally:
        subscriber.close()


def check_never_stalls(
    folder: Path, size: tuple[int, int], fps: int, seconds: float, stop: str, **environment: str
) -> None:
    """Count while the service ``stop`` stands still, record orders being given all the while."""
    rig = write_rig(folder, size, fps)
    orders = Orders()
    with supervised(rig, *CAMERAS, **environment) as stack:
        before = stack.status()["services"]
        with stopped(before[stop]["pid"]), orders.while_here():
            loads = count(stack, fps, seconds)
        for name, load in loads.items():
            # A camera's states tell whole frames, so the count may be one short at the end.
            assert load.captured >= 0.99 * load.offered - 1 > 0, (name, load)
        check_answers(orders)
        check_recovery(stack, folder / "dataset" / "stalls", orders)
        after = stack.status()["services"]
        assert {name: one["pid"] for name, one in after.items()} == {name: one["pid"] for name, one in before.items()}
    check_session(folder / "dataset" / "stalls")


def check_answers(orders: Orders) -> None:
    """Each order has its answer: samples, or a refusal with a reason that a person understands."""
    assert orders.silences == []
    assert len(orders.answers) == orders.given > 0
    for answer in orders.answers:
        if answer["ok"]:
            continue
        assert answer["error"]["message"]
        assert words_for(answer["error"]["code"]).title


def check_recovery(stack: SupervisedStack, session: Path, orders: Orders) -> None:
    """The store goes on: it records again, and settles what was under way while it stood still."""
    stack.wait_ready(*CAMERAS)
    answer = stack.ask(command="record", camera="all", count=1, timeout_s=60)
    assert answer["ok"], answer
    promised = {name for one in (answer, *orders.answers) for name in one["samples"]}
    pending = {name for one in orders.answers for name in one["pending"]}

    def settled() -> bool:
        return promised | pending <= set(SessionReader(session).samples())

    wait_for(settled, DEADLINE_S, f"{len(pending)} pending samples to be settled")


def test_two_cameras_beside_a_slow_label_process_and_a_stopped_store(tmp_path: Path) -> None:
    check_never_stalls(tmp_path, (320, 240), 15, 6.0, "store", **SLOW_LABEL)


@pytest.mark.long
@pytest.mark.parametrize("service", ["detect.0", "label.0"])
def test_two_cameras_beside_a_stopped_reader_of_their_frames(service: str, tmp_path: Path) -> None:
    check_never_stalls(tmp_path, (640, 360), 15, 6.0, service)


@pytest.mark.long
def test_two_720p_cameras_for_twenty_seconds(tmp_path: Path) -> None:
    check_never_stalls(tmp_path, (1280, 720), 30, 20.0, "store", **SLOW_LABEL)
