"""The client of a chaos run: gives orders all the while, and writes down every answer as it came."""

from __future__ import annotations

import json
import random
import threading
from pathlib import Path
from typing import Any, Self

from common.bus import CommandClient, Endpoints
from common.clock import monotonic_ns
from common.errors import TagmillError
from tools.bench.chaos.plan import CAMERAS

_ANSWER_S = 30.0
_JOIN_S = 90.0


class Journal:
    """The log of answers: one JSON line each, written out at once. Any thread."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")
        self._lock = threading.Lock()

    def write(self, **entry: Any) -> None:
        """Add a line."""
        with self._lock:
            self._file.write(json.dumps({"at_ns": monotonic_ns(), **entry}) + "\n")
            self._file.flush()

    def ask(self, client: CommandClient, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        """Give an order, and write down the answer; None where there was none."""
        sent_ns = monotonic_ns()
        try:
            answer = client.request(request, timeout_s)
        except TagmillError as error:
            self.write(sent_ns=sent_ns, request=request, silence=error.code)
            return None
        self.write(sent_ns=sent_ns, request=request, answer=answer)
        return answer

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Clients:
    """Two clients, one that starts and stops recordings, one that orders single samples, for the length of a block.

    While ``quiet`` is set they give no new orders.
    """

    def __init__(self, endpoints: Endpoints, journal: Journal, seed: int, *, short: bool) -> None:
        self._endpoints, self._journal = endpoints, journal
        self._longest_s = 2.0 if short else 8.0
        self.quiet = threading.Event()
        self._over = threading.Event()
        self._threads = [
            threading.Thread(target=run, args=(random.Random(seed + number),), name=f"client-{number}")  # noqa: S311 - no secret
            for number, run in enumerate((self._recordings, self._records))
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(_JOIN_S)

    def _recordings(self, chance: random.Random) -> None:
        with CommandClient(self._endpoints) as client:
            while not self._over.wait(0.05):
                if self.quiet.is_set():
                    continue
                request = {
                    "command": "start",
                    "camera": chance.choice((*CAMERAS, "all", "all")),
                    "every_s": chance.choice((0.0, 0.0, 0.2, 0.5)),
                }
                answer = self._journal.ask(client, request, _ANSWER_S)
                self._over.wait(chance.uniform(0.5, self._longest_s))
                if answer is not None and answer["ok"] and chance.random() < 0.9:
                    self._journal.ask(client, {"command": "stop", "recording": answer["recording"]}, _ANSWER_S)
                elif chance.random() < 0.5:
                    self._journal.ask(client, {"command": "stop"}, _ANSWER_S)

    def _records(self, chance: random.Random) -> None:
        with CommandClient(self._endpoints) as client:
            while not self._over.wait(chance.uniform(0.1, 1.0)):
                if self.quiet.is_set():
                    continue
                request = {
                    "command": "record",
                    "camera": chance.choice((*CAMERAS, "all")),
                    "count": chance.choice((1, 1, 1, 3)),
                    "timeout_s": 5.0,
                }
                self._journal.ask(client, request, _ANSWER_S)
