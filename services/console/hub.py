"""What all viewers are told: the newest of each state topic, and numbered events."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from dataclasses import dataclass
from typing import Any, Protocol

from common import clock

EVENTS_KEPT = 500


class Listener(Protocol):
    """A viewer."""

    def wake(self) -> None:
        """There is news."""

    def end(self, why: str) -> None:
        """Say good-bye."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, with its number and its text on the wire."""

    n: int
    text: str
    fields: dict[str, Any]


class StateHub:
    """Topics (whole snapshots, each with a version) and events; wakes the viewers when something changed."""

    def __init__(self) -> None:
        self.topics: dict[str, tuple[int, str]] = {}
        self.events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self.last_event = 0
        self.watched = asyncio.Event()
        self._data: dict[str, str] = {}
        self._seq = 0
        self._viewers: list[Listener] = []

    @property
    def viewers(self) -> int:
        """How many pages are connected."""
        return len(self._viewers)

    def add(self, viewer: Listener) -> None:
        """A page came; the first one makes ``watched`` true."""
        self._viewers.append(viewer)
        self.watched.set()

    def remove(self, viewer: Listener) -> None:
        """It left; after the last one nothing is kept up to date, so nothing old is kept."""
        self._viewers.remove(viewer)
        if not self._viewers:
            self.watched.clear()
            self.topics.clear()
            self._data.clear()

    def tell(self, topic: str, data: Any) -> bool:
        """The newest of a topic; True if it differs from what was told before."""
        plain = json.dumps(data, separators=(",", ":"), allow_nan=False, default=str)
        if self._data.get(topic) == plain:
            return False
        self._data[topic] = plain
        self._seq += 1
        text = f'{{"t":"state","seq":{self._seq},"topic":"{topic}","data":{plain}}}'
        self.topics[topic] = (self._seq, text)
        self._wake()
        return True

    def happened(self, kind: str, title: str, **fields: Any) -> None:
        """Something happened: told at once, and kept."""
        self.last_event += 1
        event = {
            "n": self.last_event,
            "time": clock.iso_utc(clock.wall_ns()),
            "kind": kind,
            "title": title,
            **{name: value for name, value in fields.items() if value is not None},
        }
        text = json.dumps({"t": "event", **event}, separators=(",", ":"))
        self.events.append(Event(self.last_event, text, event))
        self._wake()

    def events_after(self, n: int) -> list[Event]:
        """The events since number ``n`` that are still kept, the oldest first."""
        return [event for event in self.events if event.n > n]

    def end_all(self, why: str) -> None:
        """Send everybody home."""
        for viewer in self._viewers:
            viewer.end(why)

    def _wake(self) -> None:
        for viewer in self._viewers:
            viewer.wake()
