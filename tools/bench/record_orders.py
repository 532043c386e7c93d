"""Record orders, one after the other in a thread of their own, and what they were answered."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from common.bus import CommandClient, Endpoints
from common.errors import TagmillError

_EVERY_S = 0.5


class RecordOrders:
    """Gives orders for the length of a block, each camera (or ``all``) in turn; none without a camera.

    An order's time is up after ``timeout_s``; where even then no answer comes for ``silence_s``, that is a silence.

    ``outcomes`` counts the answers in words; ``refusals`` by code. ``acknowledged``: samples that were said to be
    durable, ``pending`` those that were still on their way when their order's time was up.
    """

    def __init__(
        self, endpoints: Endpoints, cameras: Sequence[str], *, timeout_s: float = 2.0, silence_s: float = 10.0
    ) -> None:
        self.given = 0
        self.stored = 0
        self.refusals: Counter[str] = Counter()
        self.silences: Counter[str] = Counter()
        self.acknowledged: set[str] = set()
        self.pending: set[str] = set()
        self._endpoints = endpoints
        self._cameras = cameras
        self._timeout_s = timeout_s
        self._silence_s = silence_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._give, name="orders")

    @property
    def outcomes(self) -> Counter[str]:
        """The answers, in words."""
        found = Counter({f"refused: {code}": count for code, count in self.refusals.items()})
        found += Counter({f"no answer ({code})": count for code, count in self.silences.items()})
        return found + Counter({"stored": self.stored})

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(3 * self._silence_s)

    def _give(self) -> None:
        with CommandClient(self._endpoints, timeout_s=self._silence_s) as client:
            while self._cameras and not self._over.wait(_EVERY_S):
                camera = self._cameras[self.given % len(self._cameras)]
                self.given += 1
                try:
                    answer = client.request({"command": "record", "camera": camera, "timeout_s": self._timeout_s})
                except TagmillError as error:
                    self.silences[error.code] += 1
                    continue
                self._hear(answer)

    def _hear(self, answer: dict[str, Any]) -> None:
        self.acknowledged |= set(answer["samples"])
        self.pending |= set(answer.get("pending", ()))
        if answer["ok"]:
            self.stored += 1
        else:
            self.refusals[answer["error"]["code"]] += 1
