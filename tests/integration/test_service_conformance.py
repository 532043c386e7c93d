"""What every service must do, whatever else it does (real processes, started as in production)."""

from __future__ import annotations

import importlib.util
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgpack
import psutil
import pytest
import zmq

from common import clock
from common.bus import CommandClient, Endpoints
from common.messages import ServiceState, Stamp, encode
from common.topics import SERVICE, TOPICS
from tests.support.stack import Listener, ServiceProcess, Stack, wait_for, write_rig

pytestmark = pytest.mark.process


@dataclass(frozen=True)
class Subject:
    """A service, how it is started, and its id."""

    name: str
    id: str
    arguments: tuple[str, ...] = ()
    sockets: tuple[str, ...] = ()


SUBJECTS = [
    Subject("capture", "capture.cam0", ("--camera", "cam0")),
    Subject("detect", "detect.0"),
    Subject("label", "label.0", sockets=("orders-label.0",)),
    Subject("store", "store", sockets=("orders-store",)),
    Subject("console", "console"),
    Subject("control", "control", sockets=("command",)),
]
LIMIT_S = 15.0
GARBAGE = (
    b"",
    b"\xc1",
    b"\x00" * 300,
    b"GET / HTTP/1.1\r\n\r\n",
    msgpack.packb({}),
    msgpack.packb([1, 2, 3]),
    msgpack.packb({"key": "k", "kind": "unknown"}),
    msgpack.packb({"key": "k", "kind": "store"}),
    msgpack.packb({"command": 5}),
    b"\x81" * 500,
)


@pytest.fixture(params=SUBJECTS, ids=lambda subject: subject.name)
def subject(request: pytest.FixtureRequest) -> Subject:
    found: Subject = request.param
    if importlib.util.find_spec(f"services.{found.name}.__main__") is None:
        pytest.skip(f"services.{found.name} is not there")
    return found


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return write_rig(tmp_path)


@pytest.fixture
def raw(stack: Stack) -> Iterator[zmq.Socket[bytes]]:
    """Somebody who sends what he likes straight into the bus."""
    made = zmq.Context.instance().socket(zmq.PUB)
    made.linger = 0
    made.connect(stack.endpoints.publish)
    yield made
    made.close()


def start(stack: Stack, subject: Subject, rig: Path, *more: str) -> ServiceProcess:
    return stack.start_service(subject.name, rig, *subject.arguments, *more)


def start_bus(stack: Stack, subject: Subject, rig: Path) -> None:
    """A bus for whoever doesn't bring it."""
    if subject.name != "control":
        stack.start_module("tests.support.bus_only", "--rig", str(rig))


def test_alone_it_starts_and_sigterm_ends_it_and_kill_9_makes_room_for_the_next(
    stack: Stack, subject: Subject, rig: Path
) -> None:
    first = start(stack, subject, rig)
    first.wait_for_event("service.opened")
    second = start(stack, subject, rig, "--name-wait-s", "0.3")
    assert second.wait() == 69
    assert f"(pid {first.pid})" in second.log()
    assert "Traceback" not in second.log()
    assert first.running
    first.kill()
    third = start(stack, subject, rig)
    third.wait_for_event("service.opened")
    assert third.stop(signal.SIGTERM, LIMIT_S) == 0
    assert third.events("service.drain_cut") == [], "idle, it has nothing to drain"
    assert "Traceback" not in third.log()
    assert list(stack.endpoints.run_dir.iterdir()) == []


def test_it_waits_for_the_bus_and_outlives_a_stop_and_garbage(
    stack: Stack, subject: Subject, rig: Path, raw: zmq.Socket[bytes]
) -> None:
    listener = stack.listen()
    process = start(stack, subject, rig)
    process.wait_for_event("service.opened")
    start_bus(stack, subject, rig)
    state = listener.wait_for_state(subject.id)
    assert (state.pid, state.camera) == (process.pid, "cam0" if subject.name == "capture" else None)

    process.send_signal(signal.SIGSTOP)
    wait_for(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED, 5, "the stop")
    process.send_signal(signal.SIGCONT)
    listener.subscriber.receive()
    assert listener.wait_for_state(subject.id).boot == state.boot

    _wait_until_heard(raw, listener)
    for topic in TOPICS:
        wire = topic.key(*(("cam0", "x")[: len(topic.keys)]))
        for data in GARBAGE:
            raw.send_multipart([wire, data])
            raw.send_multipart([wire + b"/more", data])
        raw.send_multipart([wire])
        raw.send_multipart([wire, b"a", b"b"])
    for name in subject.sockets:
        _send_garbage_to(stack.endpoints.ipc(name))
    _wait_until_heard(raw, listener)
    listener.heard.clear()
    after = listener.wait_for_state(subject.id)
    assert (after.boot, after.pid) == (state.boot, process.pid)
    assert process.stop(signal.SIGINT, LIMIT_S) == 0
    assert "Traceback" not in process.log()


def test_a_bad_rig_is_told_and_ends_with_78(stack: Stack, subject: Subject, tmp_path: Path) -> None:
    process = start(stack, subject, write_rig(tmp_path, "objects: 5\nnetwork: {prefiks: x}\n"))
    wait_for(lambda: "prefiks" in process.log(), 30, "the report")
    assert process.running, "a supervisor must count it as started first"
    assert process.wait() == 78
    assert "objects" in process.log()
    assert "Traceback" not in process.log()


def test_all_together_they_idle_are_in_the_status_and_outlive_a_kill_of_control(stack: Stack, rig: Path) -> None:
    listener = stack.listen()
    control, others = SUBJECTS[-1], SUBJECTS[:-1]
    processes = {subject.id: start(stack, subject, rig) for subject in (control, *others)}
    boots = {other.id: listener.wait_for_state(other.id).boot for other in others}
    _wait_for_status(stack.endpoints, set(processes))

    processes["capture.cam0"].send_signal(signal.SIGSTOP)  # without pictures there is nothing to do
    _idle(listener, {name: process for name, process in processes.items() if name != "capture.cam0"})
    processes["capture.cam0"].send_signal(signal.SIGCONT)

    processes[control.id].kill()
    start(stack, control, rig)
    for other in others:
        assert listener.wait_for_state(other.id).boot == boots[other.id], "nobody restarts because control did"
    _wait_for_status(stack.endpoints, {subject.id for subject in SUBJECTS})


def _idle(listener: Listener, processes: dict[str, ServiceProcess]) -> None:
    """They use almost no CPU over five heartbeats of each."""
    began, before = time.monotonic(), {name: process.cpu_s() for name, process in processes.items()}
    beats: dict[str, int] = dict.fromkeys(processes, 0)
    listener.subscriber.receive()

    def five_each(received: object) -> bool:
        state = received.message  # type: ignore[attr-defined]
        if isinstance(state, ServiceState) and state.service in beats:
            beats[state.service] += 1
        return min(beats.values()) >= 5

    listener.wait_for(five_each, why="five heartbeats of each")
    span = time.monotonic() - began
    shares = {name: (process.cpu_s() - before[name]) / span for name, process in processes.items()}
    assert all(share < 0.02 for share in shares.values()), shares


def _wait_until_heard(raw: zmq.Socket[bytes], listener: Listener) -> None:
    """Return once what ``raw`` sends goes through the bus: all that it sent before has gone through too."""
    listener.subscriber.subscribe(SERVICE, "raw")
    state = ServiceState(service="raw", boot="r", pid=1, phase="running")

    def heard() -> bool:
        stamp = Stamp(source="raw", boot="r", seq=1, mono_ns=clock.monotonic_ns(), wall_ns=clock.wall_ns())
        raw.send_multipart([b"service/raw", encode(state.stamped(stamp))])
        listener.subscriber.sockets[0].poll(50)
        return any(received.keys == ("raw",) for received in listener.subscriber.receive())

    wait_for(heard, 20, "the bus")


def _send_garbage_to(address: str) -> None:
    """Garbage to an order or command socket, framed in every way, until the last was taken."""
    made = zmq.Context.instance().socket(zmq.DEALER)
    made.linger = 1000
    made.immediate = 1
    made.sndtimeo = 10_000
    made.connect(address)
    try:
        for data in GARBAGE:
            made.send(data)
            made.send_multipart([b"", data])
            made.send_multipart([data, data, data])
        made.send(b"x" * (8 << 20))
    finally:
        made.close()


def _wait_for_status(endpoints: Endpoints, services: set[str]) -> None:
    """Wait until the command socket's ``status`` names all ``services`` as running."""

    def complete() -> bool:
        with CommandClient(endpoints, timeout_s=5) as client:
            answer = client.request({"command": "status"})
        assert answer["ok"] is True
        listed = answer["services"]
        states = listed if isinstance(listed, dict) else {row["service"]: row for row in listed}
        return all(
            states.get(name, {}).get("state", states.get(name, {}).get("phase")) == "running" for name in services
        )

    wait_for(complete, 30, f"{sorted(services)} to be running in the status")
