"""The console's one line to the stack: a thread that hears the bus and asks the command socket.

It alone touches ZeroMQ; everything else of the console lives in the main thread's event loop, and what is heard is
handed over there.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import clock
from common.bus import CommandClient, Endpoints, Poller, Received, Subscriber
from common.errors import TagmillError
from common.topics import Topic

Plain = dict[str, Any]
Hear = Callable[[list[Received]], None]

_ROUND_S = 0.2
MAX_AGE_S = 2.0
"""What was queued longer (the bus was away) is no news any more."""


@dataclass(frozen=True, slots=True)
class _Asked:
    answer: asyncio.Future[Plain]
    deadline_ns: int
    command: str


class Line:
    """Hears topics and asks commands; all methods are for the event loop's thread.

    ``hear`` is called in that thread with what arrived.
    """

    def __init__(
        self, endpoints: Endpoints, keys_dir: Path | None, loop: asyncio.AbstractEventLoop, hear: Hear
    ) -> None:
        self._loop = loop
        self._hear = hear
        self._tasks: deque[Callable[[], None]] = deque()
        self._asked: dict[str, _Asked] = {}
        self._closing = False
        self._ear, self._bell = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._subscriber = Subscriber(endpoints)
        self._client = CommandClient(endpoints, keys_dir=keys_dir)
        self._thread = threading.Thread(target=self._run, name="console-line")

    @property
    def bad(self) -> dict[str, int]:
        """Garbage that came over the bus, by kind."""
        return dict(self._subscriber.bad_kinds)

    @property
    def missed(self) -> dict[str, int]:
        """Messages lost in full queues, by topic."""
        return dict(self._subscriber.missed)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def subscribe(self, topic: Topic, *keys: str) -> None:
        """Hear this topic from now on."""
        self._do(lambda: self._subscriber.subscribe(topic, *keys))

    def unsubscribe(self, topic: Topic, *keys: str) -> None:
        """Hear it no more."""
        self._do(lambda: self._subscriber.unsubscribe(topic, *keys))

    def ask(self, fields: Plain, timeout_s: float) -> asyncio.Future[Plain]:
        """Ask the command socket; without an answer in time, the answer is a refusal ``no_answer``."""
        answer: asyncio.Future[Plain] = self._loop.create_future()
        asked = _Asked(answer, clock.monotonic_ns() + int(timeout_s * 1e9), str(fields.get("command")))
        self._do(lambda: self._send(fields, asked))
        return answer

    def close(self) -> None:
        """End the thread and close the sockets; idempotent. Whoever still waits is told so."""
        if self._closing:
            return
        self._closing = True
        self._ring()
        if self._thread.ident is not None:
            self._thread.join()
        else:
            self._subscriber.close()
            self._client.close()
        for asked in self._asked.values():
            if not asked.answer.done():
                asked.answer.set_result(_refusal("stopping", "the console is being stopped"))
        os.close(self._ear)
        os.close(self._bell)

    def _do(self, task: Callable[[], None]) -> None:
        if not self._closing:
            self._tasks.append(task)
            self._ring()

    def _ring(self) -> None:
        with suppress(BlockingIOError):  # full: it will wake up anyhow
            os.write(self._bell, b"!")

    # --- in the thread ------------------------------------------------------------------------------------

    def _run(self) -> None:
        poller = Poller(self._subscriber, self._client, self._ear)
        try:
            while not self._closing:
                poller.wait(_ROUND_S)
                with suppress(BlockingIOError):
                    os.read(self._ear, 4096)
                while self._tasks:
                    self._tasks.popleft()()
                received = self._subscriber.receive(max_age_s=MAX_AGE_S)
                if received:
                    self._loop.call_soon_threadsafe(self._hear, received)
                for number, answer in self._client.receive():
                    self._settle(self._asked.pop(number, None), answer)
                self._expire()
        finally:
            self._subscriber.close()
            self._client.close()

    def _send(self, fields: Plain, asked: _Asked) -> None:
        try:
            self._asked[self._client.send(fields)] = asked
        except TagmillError as error:
            self._settle(asked, _refusal(error.code, error.message))

    def _expire(self) -> None:
        now = clock.monotonic_ns()
        for number in [number for number, asked in self._asked.items() if now >= asked.deadline_ns]:
            asked = self._asked.pop(number)
            words = f"'{asked.command}' got no answer from {self._client.address}; is the stack running?"
            self._settle(asked, _refusal("no_answer", words))

    def _settle(self, asked: _Asked | None, answer: Plain) -> None:
        if asked is not None:
            self._loop.call_soon_threadsafe(_set, asked.answer, answer)


def _set(future: asyncio.Future[Plain], answer: Plain) -> None:
    if not future.done():
        future.set_result(answer)


def _refusal(code: str, message: str) -> Plain:
    return {"ok": False, "error": {"code": code, "message": message}}
