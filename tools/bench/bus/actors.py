"""The processes of `bench bus`: one producer, one proxy, many readers. They take orders as JSON lines on stdin.

``python -m tools.bench.bus.actors producer|reader|proxy``; each ends when its stdin does.
"""

from __future__ import annotations

import importlib
import json
import select
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import cv2

from common import clock
from common.bus import Endpoints, Poller, Proxy
from common.config.models import NetworkConfig
from tools.bench.bus.frames import Form, Receiver, Sender, camera_frames, cpu_s

_JOIN_EVERY_S = 0.05
_WARM_UP_FRAMES = 26
"""Twice round the ring: by then each page of it is mapped in each reader, as it is in a stack that runs."""
_WARM_UP_S = 0.012
_SETTLE_S = 0.15
_SILENCE_S = 3.0
_JOIN_S = 20.0

SENDERS: dict[str, Callable[[str], Sender]] = {
    "ring": lambda place: _load("ring").RingSender(),  # noqa: ARG005 - it goes by the run folder
    "zmq": lambda place: _load("raw_zmq").ZmqSender(place),
    "iceoryx2": lambda place: _load("iceoryx").IceoryxSender(place),
}
RECEIVERS: dict[str, Callable[[str, Form], Receiver]] = {
    "ring": lambda place, form: _load("ring").RingReceiver(form),  # noqa: ARG005
    "zmq": lambda place, form: _load("raw_zmq").ZmqReceiver(place),  # noqa: ARG005
    "iceoryx2": lambda place, form: _load("iceoryx").IceoryxReceiver(place, form),
}


def _load(name: str) -> Any:
    """A rival is imported only where it takes part."""
    return importlib.import_module(f"tools.bench.bus.{name}")


def say(**what: Any) -> None:
    """A line to whoever started this process."""
    print(json.dumps(what), flush=True)


def told(timeout_s: float) -> bool:
    """Whether there is a line to read."""
    return bool(select.select([sys.stdin], [], [], timeout_s)[0])


def hear() -> dict[str, Any] | None:
    """The next order; None at the end."""
    line = sys.stdin.readline()
    return json.loads(line) if line else None


def produce() -> None:
    """Open, warm up until told to go, send at a rate, say what it cost once the readers are through."""
    frames = camera_frames()
    while (order := hear()) is not None:
        sender = SENDERS[order["way"]](order["place"])
        try:
            say(opened=True)
            while not told(_JOIN_EVERY_S):
                sender.send(frames[0], 0, clock.monotonic_ns())
            go = hear()
            if go is None:
                return
            pause = Poller()
            for number in range(_WARM_UP_FRAMES):
                pause.wait(_WARM_UP_S)
                sender.send(frames[number % len(frames)], 0, clock.monotonic_ns())
            pause.wait(_SETTLE_S)
            say(warm=True)
            begun, began_ns = cpu_s(), clock.monotonic_ns()
            for count in range(1, go["frames"] + 1):
                due_ns = began_ns + int(count * 1e9 / go["fps"])
                pause.wait(max(due_ns - clock.monotonic_ns(), 0) / 1e9)
                sender.send(frames[count % len(frames)], count, clock.monotonic_ns())
            say(sent=go["frames"])
            if hear() is None:
                return
            say(cpu_s=cpu_s() - begun)
        finally:
            sender.close()


def read() -> None:
    """Open, say when the first frame has come, take the counted ones, say what it cost."""
    while (order := hear()) is not None:
        receiver = RECEIVERS[order["way"]](order["place"], order["form"])
        try:
            _read(receiver, int(order["frames"]))
        finally:
            receiver.close()


def _read(receiver: Receiver, wanted: int) -> None:
    late_ms: list[float] = []
    joined, newest = False, 0
    deadline_ns = clock.monotonic_ns() + int(_JOIN_S * 1e9)
    before = cpu_s()
    while newest < wanted and clock.monotonic_ns() < deadline_ns:
        if newest == 0:
            before = cpu_s()
        for taken in receiver.receive(0.2):
            now = clock.monotonic_ns()
            deadline_ns = now + int((_SILENCE_S if taken.count else _JOIN_S) * 1e9)
            if taken.count:
                newest = taken.count
                late_ms.append((now - taken.captured_ns) / 1e6)
            elif not joined:
                joined = True
                say(joined=True)
    say(cpu_s=cpu_s() - before, late_ms=late_ms, lost=wanted - len(late_ms))


def proxy() -> None:
    """The bus, and what it has cost so far whenever asked."""
    bus = Proxy(Endpoints.of(NetworkConfig()))
    bus.start()
    try:
        say(opened=True)
        while hear() is not None:
            say(cpu_s=cpu_s())
    finally:
        bus.close()


def main(role: str) -> int:
    """One actor, until its stdin ends."""
    cv2.setNumThreads(1)
    roles = {"producer": produce, "reader": read, "proxy": proxy}
    with suppress(KeyboardInterrupt):
        roles[role]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
