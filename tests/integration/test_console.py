"""The console with the real stack: pictures in step with their labels, commands, its guard, and what happens when
something dies (real processes, started as in production)."""

from __future__ import annotations

import json
import signal
import socket
import struct
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from tests.support.rigs import SIDES, box
from tests.support.stack import ServiceProcess, Stack, write_rig

pytestmark = pytest.mark.process

RIG = (
    """\
dataset: {root: ./dataset, session: test}
objects:
"""
    + box(sides=SIDES[:4])
    + """\
cameras:
  cam0: {driver: synthetic, width: 640, height: 360, fps: 6, burn_frame: true}
ring: {slots: 12, samples: 4}
"""
)
WAIT_S = 40.0
Plain = dict[str, Any]


class Page:
    """A page's side of the socket: hears everything, draws (acknowledges) what it is told to."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.pictures: list[tuple[Plain, bytes]] = []
        self.events: list[Plain] = []
        self.state: dict[str, Plain] = {}
        self.bye: str | None = None

    def say(self, **message: Any) -> None:
        self.connection.send(json.dumps(message))

    def watch(self, *kinds: str, width: int = 640, visible: bool = True) -> None:
        views = [{"id": kind, "camera": "cam0", "kind": kind, "width": width} for kind in kinds]
        self.say(t="watch", views=views, visible=visible)

    def hear(self, *, draw: bool = True, limit_s: float = WAIT_S) -> str:
        """The next message: ``picture``, ``state``, ``event``, ``pong`` or ``bye``."""
        message = self.connection.recv(timeout=limit_s)
        if isinstance(message, bytes):
            (length,) = struct.unpack_from("<I", message)
            header = json.loads(message[4 : 4 + length])
            self.pictures.append((header, message[4 + length :]))
            if draw:
                # A server that goes has closed already; its good-bye is still to be heard.
                with suppress(ConnectionClosed):
                    self.say(t="ack", id=header["id"], seq=header["seq"])
            return "picture"
        plain = json.loads(message)
        match plain["t"]:
            case "state":
                self.state[plain["topic"]] = plain["data"]
            case "event":
                self.events.append(plain)
            case "bye":
                self.bye = plain["why"]
        return str(plain["t"])

    def until(self, true: Callable[[], Any], why: str, *, draw: bool = True, messages: int = 3000) -> None:
        """Hear until something is true."""
        for _ in range(messages):
            if true():
                return
            self.hear(draw=draw)
        raise AssertionError(f"in vain for {why}; state {self.state}, events {self.events[-5:]}")

    def newest(self, kind: str = "rgb") -> tuple[Plain, bytes]:
        return next(item for item in reversed(self.pictures) if item[0]["kind"] == kind)


class Console:
    """A stack with its console."""

    def __init__(self, stack: Stack, rig: Path) -> None:
        services = (("control",), ("store",), ("label",), ("detect",), ("capture", "--camera", "cam0"))
        self.services = {name: stack.start_service(name, rig, *more) for name, *more in services}
        self.process = stack.start_service("console", rig)
        self.url = str(self.process.wait_for_event("console.ready")["url"])
        listener = stack.listen()
        for service in ("control", "store", "label.0", "detect.0", "capture.cam0", "console"):
            listener.wait_for_state(service)

    @contextmanager
    def page(self, *, greet: bool = True, origin: str | None = None) -> Iterator[Page]:
        address = self.url.replace("http", "ws") + "/ws"
        with connect(address, origin=Origin(origin or self.url), max_size=None, compression=None) as connection:
            page = Page(connection)
            if greet:
                page.say(t="hello", v=1)
            yield page

    def get(self, path: str, **headers: str) -> tuple[int, bytes]:
        return self._ask(urllib.request.Request(self.url + path, headers=headers))

    def post(self, command: str, **fields: Any) -> tuple[int, Plain]:
        request = urllib.request.Request(
            f"{self.url}/api/commands/{command}",
            json.dumps(fields).encode(),
            {"Content-Type": "application/json", "Origin": self.url},
        )
        status, body = self._ask(request)
        return status, json.loads(body)

    @staticmethod
    def _ask(request: urllib.request.Request) -> tuple[int, bytes]:
        try:
            with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()


@pytest.fixture
def console(stack: Stack, tmp_path: Path) -> Console:
    return Console(stack, write_rig(tmp_path, RIG))


def pixels(jpeg: bytes) -> np.ndarray[Any, np.dtype[np.uint8]]:
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def test_a_page_sees_records_takes_back_and_covers(console: Console) -> None:
    from common.scene.burnt import read_number

    with console.page() as page:
        page.watch("rgb", "depth", "after")
        page.until(lambda: {"rgb", "depth", "after"} <= {h["kind"] for h, _ in page.pictures}, "all kinds of pictures")
        page.until(lambda: page.newest()[0]["label"] is not None, "a label")
        for header, jpeg in page.pictures:
            if header["kind"] == "rgb":
                picture = pixels(jpeg)
                assert list(picture.shape[1::-1]) == header["size"] == header["source_size"] == [640, 360]
                assert read_number(picture) == header["frame"] - 1, "the header is that of this very picture"
        depth, _ = page.newest("depth")
        assert depth["depth_range_mm"][0] < depth["depth_range_mm"][1]
        page.until(lambda: page.state.get("record", {}).get("can", {}).get("cam0", {}).get("ok"), "that it can record")
        assert page.state["record"]["phase"] == "ready"
        page.until(lambda: page.state.get("coverage"), "the present view")

        status, answer = console.post("record", camera="cam0", timeout_s=30)
        assert (status, answer["ok"]) == (200, True), answer
        (sample,) = answer["samples"]
        page.until(lambda: any(e["kind"] == "saved" and e["sample"] == sample for e in page.events), "it to be told")
        page.until(lambda: (page.state["record"]["last"] or {}).get("sample") == sample, "it to be the last")

        assert console.get(f"/api/samples/{sample}/thumb")[1][:2] == b"\xff\xd8"
        assert pixels(console.get(f"/api/samples/{sample}/depth")[1]).shape == (360, 640, 3)
        assert console.get(f"/api/samples/{sample}/rgb")[1][:4] == b"\x89PNG"
        assert json.loads(console.get(f"/api/samples/{sample}/label")[1])["sample"] == sample
        covered = json.loads(console.get("/api/coverage?object=box-1")[1])
        assert (covered["total"], sum(map(sum, covered["counts"]))) == (1, 1)

        assert console.post("undo")[1] == {"ok": True, "samples": [sample]}
        page.until(lambda: any(e["kind"] == "deleted" for e in page.events), "the deletion to be told")
        assert console.get(f"/api/samples/{sample}/thumb")[0] == 404
        assert console.get(f"/api/samples/{sample}/rgb?bin=1")[0] == 200
        assert console.post("restore", samples=[sample])[0] == 200
        assert console.get(f"/api/samples/{sample}/rgb")[0] == 200

        status, answer = console.post("start", camera="cam0", mode="auto", new_deg=1, sharpness=0)
        assert status == 200
        page.until(lambda: page.state["record"]["phase"] == "recording", "the recording")
        page.until(lambda: (page.state.get("auto") or {}).get("cam0", {}).get("objects"), "what auto thinks")
        assert page.state["auto"]["cam0"]["limits"]["new_deg"] == 1
        page.until(lambda: page.state["record"]["count"] >= 2, "two samples")
        status, answer = console.post("stop", recording=answer["recording"])
        assert answer["ledgers"][0]["cameras"]["cam0"]["recorded"] >= 2
        page.until(lambda: page.state["record"]["phase"] == "ready", "the end")

    text = console.get("/metrics")[1].decode()
    assert 'tagmill_label_latency_seconds_count{camera="cam0"}' in text
    assert 'tagmill_service_up{service="store"} 1.0' in text
    assert console.get("/healthz")[0] == 200
    assert console.process.stop() == 0


def test_nobody_is_waited_for_and_strangers_are_kept_out(console: Console) -> None:
    with ExitStack() as pages:
        slow = pages.enter_context(console.page())
        slow.watch("rgb")
        fast = pages.enter_context(console.page())
        fast.watch("rgb", width=100)
        fast.until(lambda: len(fast.pictures) >= 30, "30 pictures")
        assert fast.newest()[0]["size"] == [160, 90]
        slow.say(t="ping")
        heard: list[str] = []
        while not heard or heard[-1] != "pong":
            heard.append(slow.hear(draw=False))
        assert heard.count("picture") == 2, "two are under way, none is queued, state goes on"
        frames = [header["frame"] for header, _ in slow.pictures]
        slow.say(t="ack", id="rgb", seq=slow.pictures[-1][0]["seq"])
        slow.until(lambda: len(slow.pictures) == 3, "the newest picture", draw=False)
        assert slow.pictures[-1][0]["frame"] > frames[-1] + 10, "not the one after the last"

        hidden = pages.enter_context(console.page())
        hidden.watch("rgb", visible=False)
        hidden.say(t="ping")
        hidden.until(lambda: "disk" in hidden.state, "state")
        assert not hidden.pictures

        for _ in range(13):
            pages.enter_context(console.page())
        with console.page(greet=False) as seventeenth:
            assert seventeenth.hear() == "bye"
            assert "16 pages are open" in (seventeenth.bye or "")
        assert fast.hear() in {"picture", "state"}, "the others don't notice"

    for garbage in ("{", '{"t": "watch"}', '{"t": "hello", "v": 2}', '{"t": "record"}', "x" * 10_000):
        with console.page(greet=False) as rude:
            rude.connection.send(garbage)
            rude.until(lambda rude=rude: rude.bye is not None, "a good-bye in words")  # type: ignore[misc]
    with console.page() as flooding:
        flooding.connection.send("x" * 70_000)
        with pytest.raises(ConnectionClosed):
            flooding.until(lambda: False, "the end")
    with pytest.raises(InvalidStatus), console.page(origin="http://evil.example"):
        pass
    assert console.get("/api/status", Origin="http://evil.example")[0] == 403
    assert console.get("/api/status", Host="evil.example")[0] == 421
    assert console.get("/api/samples/..%2f..%2f..%2frig.yaml/rgb")[0] == 404
    assert console.get("/static/..%2f..%2fguard.py")[0] == 404
    status, answer = console.post("record", camera="cam0", frames=3)
    assert (status, answer["error"]["code"]) == (422, "unknown_field")
    assert console.get("/healthz")[0] == 200, "and it still runs"


def test_without_detect_the_picture_goes_on_and_it_is_seen_to_come_back(
    console: Console, stack: Stack, tmp_path: Path
) -> None:
    with console.page() as page:
        page.watch("rgb")
        page.until(lambda: page.pictures and page.newest()[0]["label"] is not None, "a label")
        console.services["detect"].kill()
        page.until(
            lambda: page.newest()[0]["label"] is None and page.newest()[0]["why"] == "detect_down", "pictures without"
        )
        page.until(lambda: page.state["record"]["can"]["cam0"].get("code") == "detect_down", "the reason")
        seen = page.newest()[0]["frame"]
        page.until(lambda: page.newest()[0]["frame"] > seen + 5, "the picture to go on")
        stack.start_service("detect", tmp_path / "rig.yaml")
        page.until(lambda: page.newest()[0]["label"] is not None, "labels again")
        console.process.send_signal(signal.SIGTERM)
        page.until(lambda: page.bye is not None, "a good-bye")
    assert console.process.wait() == 0


def run_alone(stack: Stack, rig: Path) -> ServiceProcess:
    return stack.start_service("console", rig, "--name-wait-s", "0")


def test_a_port_in_use_and_a_rig_without_a_console_are_told_in_a_sentence(stack: Stack, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        rig = write_rig(tmp_path, RIG + f"network: {{console: 'http://127.0.0.1:{port}'}}\n")
        process = run_alone(stack, rig)
        assert process.wait() == 69
        assert f"http://127.0.0.1:{port} is in use by another program" in process.log()
    process = run_alone(stack, write_rig(tmp_path, RIG + "network: {console: null}\n"))
    assert process.wait() == 78
    assert "there shall be no console" in process.log()


def test_off_loopback_the_log_shows_the_address_with_the_token(stack: Stack, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, RIG + "network: {console: 'http://0.0.0.0:0'}\n")
    process = run_alone(stack, rig)
    url = str(process.wait_for_event("console.ready")["url"])
    assert "/?token=" in url
    address = url.partition("/?token=")[0].replace("0.0.0.0", "127.0.0.1")
    with pytest.raises(urllib.error.HTTPError, match="401"):
        urllib.request.urlopen(address + "/live", timeout=WAIT_S)
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with opener.open(url.replace("0.0.0.0", "127.0.0.1"), timeout=WAIT_S) as answer:
        assert answer.url == address + "/live"
    process.kill()
    again = run_alone(stack, rig)
    assert str(again.wait_for_event("console.ready")["url"]).endswith(url.partition("token=")[2])
    assert again.stop() == 0
    assert not list(stack.endpoints.run_dir.glob("console.token"))
