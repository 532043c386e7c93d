"""The real control process, over its command socket: whatever comes in, each client gets one answer.

Peers are the real store and a scripted label process, whose outcomes the tests choose.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.bus import CommandClient
from common.errors import EXIT_NAME_TAKEN
from common.ids import sample_camera
from tests.support.hygiene import Place, own_place
from tests.support.stack import RIG, ServiceProcess, Stack, wait_for, write_rig

pytestmark = pytest.mark.process

ANSWER_S = 60.0


@dataclass
class Up:
    """A control with its peers, ready."""

    stack: Stack
    rig: Path
    control: ServiceProcess
    label: ServiceProcess
    client: CommandClient
    seen: int = 0
    """Orders of earlier tests."""

    def ask(self, command: str, **fields: Any) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(json.dumps(self.client.request({"command": command, **fields}, ANSWER_S)))
        return answer

    def refused(self, command: str, **fields: Any) -> tuple[str, str]:
        answer = self.ask(command, **fields)
        assert answer["ok"] is False, answer
        return answer["error"]["code"], answer["error"]["message"]

    def orders(self, kind: str | None = None) -> list[dict[str, Any]]:
        """What the label process was told to do."""
        told = self.label.events("order")[self.seen :]
        return [event for event in told if kind in (None, event["kind"])]

    def wait_for_status(self, fits: Callable[[dict[str, Any]], Any], why: str) -> dict[str, Any]:
        def look() -> dict[str, Any] | None:
            status = self.ask("status")
            return status if fits(status) else None

        return wait_for(look, 30.0, why)


@contextmanager
def control_with_peers(stack: Stack) -> Iterator[Up]:
    """Control, the real store, the scripted label process and its two cameras."""
    rig = write_rig(stack.folder)
    control = stack.start_service("control", rig)
    stack.start_service("store", rig)
    label = stack.start_module("tests.support.scripted_peers", "--rig", str(rig))
    with CommandClient(stack.endpoints, ANSWER_S) as client:
        made = Up(stack, rig, control, label, client)
        control.wait_for_event("service.opened")
        made.wait_for_status(
            lambda status: (
                len(status["cameras"]) == 2
                and all(status["services"].get(name, {}).get("phase") == "running" for name in ("label.0", "store"))
            ),
            "two cameras, label and store",
        )
        yield made


@pytest.fixture
def up(stack: Stack) -> Iterator[Up]:
    """A stack for one test alone."""
    with control_with_peers(stack) as made:
        yield made


def raw_socket(up: Up, kind: int) -> zmq.Socket[bytes]:
    made: zmq.Socket[bytes] = zmq.Context.instance().socket(kind)
    made.setsockopt(zmq.LINGER, 0)
    made.connect(up.stack.endpoints.command)
    return made


def received(made: zmq.Socket[bytes]) -> list[bytes]:
    assert made.poll(int(ANSWER_S * 1000)), "no answer"
    return made.recv_multipart()


def _packed(fields: dict[str, Any]) -> bytes:
    try:
        data: bytes = msgpack.packb(fields | {"command": "stpo"})
    except (OverflowError, UnicodeEncodeError):
        return b"\xc1"
    return data


@pytest.fixture(scope="class")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """A stack for a class of tests."""
    with pytest.MonkeyPatch.context() as patch, own_place(patch) as place:
        stack = Stack(place, tmp_path_factory.mktemp("control"))
        try:
            with control_with_peers(stack) as made:
                yield made
        finally:
            stubborn = stack.close()
            print(stack.logs())  # shown if the last test or this end has failed
    assert stubborn == []


class TestOneControlForAll:
    """What leaves control as it was: all on one stack, whose start takes longer than any of them."""

    @pytest.fixture(autouse=True)
    def place(self, shared: Up) -> Place:
        """Instead of a place for each test: what is left behind is looked for once, at the end."""
        return shared.stack.place

    @pytest.fixture
    def up(self, shared: Up) -> Up:
        """The shared stack; `orders` are those of this test."""
        shared.seen = len(shared.label.events("order"))
        return shared

    def test_garbage_is_answered_and_changes_nothing(self, up: Up) -> None:
        socket = raw_socket(up, zmq.DEALER)

        @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
        @given(
            st.binary(max_size=300)
            | st.sampled_from(
                [msgpack.packb({"command": "stop"})[:-1], msgpack.packb(["stop"]), b"\xc1", b'{"command"}']
            )
            | st.dictionaries(st.text(max_size=6), st.integers() | st.text(max_size=6), max_size=3).map(_packed)
        )
        def send(data: bytes) -> None:
            socket.send_multipart([b"", data])
            _, body = received(socket)
            answer = msgpack.unpackb(body)
            assert answer["ok"] is False
            assert answer["error"]["message"]

        send()
        for parts in ([b"x", msgpack.packb({"command": "stop"})], [b"", b"", b""], [b""] * 5):
            socket.send_multipart(parts)
        socket.send_multipart([b"", msgpack.packb({"command": "help"})])
        while not msgpack.unpackb(received(socket)[-1])["ok"]:
            pass
        socket.close()
        assert up.orders() == []
        status = up.wait_for_status(lambda status: "control" in status["services"], "control to have heard itself")
        assert status["recordings"] == {}
        assert status["services"]["control"]["restarts"] == 0
        assert up.ask("record", camera="cam0")["ok"] is True

    def test_ten_lines_of_pyzmq_and_msgpack_are_enough(self, up: Up) -> None:
        socket = raw_socket(up, zmq.REQ)
        socket.send(msgpack.packb({"command": "record", "camera": "cam0", "count": 5}))
        answer = msgpack.unpackb(received(socket)[0])
        socket.send(msgpack.packb({"command": "help"}))
        told = msgpack.unpackb(received(socket)[0])
        socket.close()
        assert answer["ok"] is True
        assert [sample_camera(name) for name in answer["samples"]] == ["cam0"] * 5
        assert "record" in told["commands"]

    def test_dealers_are_answered_with_the_envelope_they_sent(self, up: Up) -> None:
        socket = raw_socket(up, zmq.DEALER)
        request = msgpack.packb({"command": "help"})
        for envelope in ([], [b""], [b"7", b""]):
            socket.send_multipart([*envelope, request])
            *came, body = received(socket)
            assert came == envelope
            assert msgpack.unpackb(body)["ok"] is True
        socket.close()

    def test_an_oversized_request_costs_its_sender_the_connection_only(self, up: Up) -> None:
        socket = raw_socket(up, zmq.DEALER)
        socket.send_multipart([b"", msgpack.packb({"command": "stop", "x": "y" * 70_000})])
        socket.send_multipart([b"", msgpack.packb({"command": "stop", "x": "y" * 65_000})])
        _, body = received(socket)
        socket.close()
        assert msgpack.unpackb(body)["error"]["code"] == "unknown_field", "within the limit, after a reconnection"
        assert up.ask("help")["ok"] is True
        assert up.orders() == []

    def test_two_hundred_clients_at_once_get_one_answer_each(self, up: Up) -> None:
        sockets = [raw_socket(up, zmq.DEALER) for _ in range(200)]
        for number, socket in enumerate(sockets):
            socket.send(msgpack.packb({"command": "record", "camera": "cam0" if number % 4 else "cam9"}))
        answers = [msgpack.unpackb(received(socket)[-1]) for socket in sockets]
        more = [socket for socket in sockets if socket.poll(0)]
        for socket in sockets:
            socket.close()
        assert more == []
        samples = [name for answer in answers if answer["ok"] for name in answer["samples"]]
        assert len(samples) == len(set(samples)) == 150
        refused = [answer["error"]["code"] for answer in answers if not answer["ok"]]
        assert refused == ["no_camera"] * 50

    def test_a_client_that_went_away_is_dropped(self, up: Up) -> None:
        socket = raw_socket(up, zmq.DEALER)
        socket.send(msgpack.packb({"command": "record", "camera": "cam0", "background": True, "timeout_s": 0.2}))
        wait_for(lambda: up.orders("record"), why="the order")
        socket.close()
        up.wait_for_status(
            lambda status: status["services"]["control"]["dropped"].get("client_gone"), "the lost client to be counted"
        )
        assert up.ask("record", camera="cam0")["ok"] is True

    def test_all_cameras_give_a_sample_and_the_one_that_fails_is_named(self, up: Up) -> None:
        answer = up.ask("record", camera="all", count=2)
        assert answer["ok"] is False
        assert answer["error"]["code"] == "no_object"
        assert answer["error"]["message"].startswith("cam1: ")
        assert [sample_camera(name) for name in answer["samples"]] == ["cam0", "cam0"]
        assert list(answer["cameras"]) == ["cam1"]
        orders = up.orders("record")
        assert len({order["recording"] for order in orders}) == len({order["since_mono_ns"] for order in orders}) == 1

    def test_silence_of_a_label_process_is_answered_by_control(self, up: Up) -> None:
        answer = up.ask("record", camera="cam0", background=True, timeout_s=0.1)
        assert answer["error"]["code"] == "timeout"
        assert answer["samples"] == answer["pending"] == []

    def test_a_recording_runs_from_start_to_its_ledger(self, up: Up) -> None:
        started = up.ask("start", camera="all", every_s=2)
        assert started == {"ok": True, "recording": started["recording"], "cameras": ["cam0", "cam1"], "missing": []}
        recording = started["recording"]
        status = up.wait_for_status(
            lambda status: len(status["recordings"].get(recording, {}).get("cameras", ())) == 2, "the recording"
        )
        assert status["recordings"][recording]["phase"] == "running"
        assert up.refused("session", name="other")[0] == "wrong_state"
        assert up.ask("ledger", recording=recording)["ledger"]["phase"] == "running"
        (ledger,) = up.ask("stop")["ledgers"]
        assert ledger["phase"] == "ended"
        assert {name: account["recorded"] for name, account in ledger["cameras"].items()} == {"cam0": 4, "cam1": 4}
        assert up.ask("ledger", recording=recording)["ledger"]["phase"] == "ended"
        assert up.ask("stop") == {"ok": True, "ledgers": []}
        code, message = up.refused("stop", recording="rec-unknown")
        assert (code, "none is running" in message) == ("no_recording", True)

    def test_a_stop_right_after_the_start_finds_the_recording(self, up: Up) -> None:
        up.wait_for_status(lambda status: status["settled"], "control to know the stack")
        for _ in range(5):
            recording = up.ask("start", camera="cam0")["recording"]
            assert recording in up.ask("status")["recordings"]
            (ledger,) = up.ask("stop")["ledgers"]
            assert (ledger["spec"]["recording"], ledger["phase"]) == (recording, "ended")
        assert up.ask("preview", camera="all") == {"ok": True, "cameras": ["cam0", "cam1"], "lease_s": 5.0}

    def test_a_start_that_one_camera_refuses_is_taken_back(self, up: Up) -> None:
        code, message = up.refused("start", camera="all", every_s=99)
        assert (code, "cam1" in message, "no recording was begun" in message) == ("wrong_state", True, True)
        assert [order["camera"] for order in up.orders("stop")] == ["cam0"]
        assert up.refused("start", camera="cam7")[0] == "no_camera"

    def test_a_second_control_is_refused(self, up: Up) -> None:
        second = up.stack.start_service("control", up.rig, "--name-wait-s", "0")
        assert second.wait() == EXIT_NAME_TAKEN
        assert up.ask("record", camera="cam0")["ok"] is True

    def test_a_session_is_opened_by_the_store(self, up: Up) -> None:
        assert up.ask("session", name="tuesday")["session"] == "tuesday"
        assert up.ask("status")["session"] == "tuesday"
        assert (up.rig.parent / "dataset" / "tuesday" / "session.json").is_file()


def test_a_stopped_label_process_is_never_silence(up: Up) -> None:
    up.wait_for_status(lambda status: status["settled"], "control to know the stack")
    up.label.send_signal(signal.SIGSTOP)
    assert up.refused("preview", camera="cam0")[0] == "timeout"
    up.wait_for_status(lambda status: "label.0" in status["missing"], "label.0 to be missing")
    assert up.refused("record", camera="cam0")[0] == "label_down"
    up.label.send_signal(signal.SIGCONT)
    up.wait_for_status(lambda status: "label.0" not in status["missing"], "label.0 to be back")
    assert up.ask("record", camera="cam0")["ok"] is True
    assert [order["camera"] for order in up.orders("record")] == ["cam0"], "nothing of what was refused"


def test_a_start_that_is_not_answered_is_taken_back_when_the_label_process_goes_on(up: Up) -> None:
    up.wait_for_status(lambda status: status["settled"], "control to know the stack")
    up.label.send_signal(signal.SIGSTOP)
    assert up.refused("start", camera="cam0")[0] == "timeout"
    up.label.send_signal(signal.SIGCONT)
    wait_for(lambda: up.orders("stop"), why="the order that takes the start back")
    (begun,) = up.orders("start")
    assert up.orders("stop")[0]["recording"] == begun["spec"]["recording"]


def test_a_killed_control_comes_back_and_knows_what_runs(up: Up) -> None:
    recording = up.ask("start", camera="cam0")["recording"]
    up.wait_for_status(lambda status: recording in status["recordings"], "the recording")
    up.control.kill()
    up.control = up.stack.start_service("control", up.rig)
    # Asked at once: it waits until control has heard a round of states.
    (ledger,) = up.ask("stop")["ledgers"]
    assert (ledger["spec"]["recording"], ledger["phase"]) == (recording, "ended")
    assert up.ask("record", camera="cam0")["ok"] is True
    assert up.ask("status")["shares"]["label"] == {"cam0": 0, "cam1": 0}


def test_reload_takes_over_a_good_file_and_refuses_others(up: Up) -> None:
    assert up.ask("reload")["changed"] == []
    up.rig.write_text(RIG.replace("marker: 0", "marker: -1").replace("fps: 10", "fps: fast"))
    answer = up.ask("reload")
    assert answer["error"]["code"] == "bad_config"
    assert len(answer["problems"]) == 3
    up.rig.write_text(RIG + "workers: {label: 2}\nmarkers: {family: apriltag_16h5}\n")
    code, message = up.refused("reload")
    assert (code, "markers" in message, "workers" in message) == ("needs_restart", True, True)
    before = len(up.orders("reload"))
    up.rig.write_text(RIG.replace("size_mm: {width: 400", "size_mm: {width: 410"))
    assert up.refused("reload")[0] == "session_differs"
    assert len(up.orders("reload")) == before, "the store is asked first"
    up.rig.write_text(RIG + "inpaint: {margin: 0.2}\n")
    assert up.ask("reload")["changed"] == ["inpaint"]
    assert len(up.orders("reload")) == before + 1


def test_whoever_waits_when_control_goes_down_is_told(up: Up) -> None:
    socket = raw_socket(up, zmq.DEALER)
    socket.send(msgpack.packb({"command": "record", "camera": "cam0", "background": True, "timeout_s": 60}))
    wait_for(lambda: up.orders("record"), why="the order")
    up.control.send_signal(signal.SIGTERM)
    answer = msgpack.unpackb(received(socket)[-1])
    socket.close()
    assert answer["error"]["code"] == "stopping"
    assert up.control.wait() == 0
