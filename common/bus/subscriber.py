"""Subscribing: strict decoding, `latest` by draining, and an account of everything that didn't arrive."""

from __future__ import annotations

from typing import NamedTuple

import zmq

from common import clock, log
from common.bus.endpoints import Endpoints
from common.bus.keyparts import has_valid_keys
from common.bus.sockets import BUS_QUEUE, PREVIEW_QUEUE, ROOM_FOR_FRAMING, Socket, drain, new_socket
from common.errors import CodecError
from common.messages import MAX_BYTES, Message, Stamp, decode
from common.topics import PREVIEW, Topic, topic_of

_LOG = log.get()
_MAX_DRAIN = 1000
"""Messages taken in one call, so that a flood can't keep a reader in its drain."""
_MOST_ROUTES = 1000
"""Topics remembered: whoever floods the bus with names must not make a reader grow."""

_Route = tuple[Topic, tuple[str, ...]]
_Row = tuple[bytes, _Route, bytes]


class Received(NamedTuple):
    """A valid message with its topic and key parts; ``stamp`` says who sent it and when."""

    topic: Topic
    keys: tuple[str, ...]
    message: Message
    stamp: Stamp
    received_ns: int

    @property
    def age_ns(self) -> int:
        """Nanoseconds (monotonic) from sending to receiving: large for what was queued while the bus was down."""
        return max(0, self.received_ns - self.stamp.mono_ns)


class Subscriber:
    """Receives the subscribed topics. One a thread.

    ``bad``: garbage, by kind in ``bad_kinds``, logged once a kind. By topic: ``superseded`` (a newer message of
    a ``latest`` topic was there), ``missed`` (gaps in the sequence: lost in full queues), ``stale`` (older than
    the reader wanted). ``sockets`` is for the Poller.
    """

    def __init__(self, endpoints: Endpoints) -> None:
        self.bad_kinds: dict[str, int] = {}
        self.superseded: dict[str, int] = {}
        self.missed: dict[str, int] = {}
        self.stale: dict[str, int] = {}
        self._endpoints = endpoints
        self._wanted: set[bytes] = set()
        self._whole: set[str] = set()
        self._routes: dict[bytes, _Route] = {}
        self._last: dict[bytes, tuple[str, int]] = {}
        bus = _connect(endpoints.subscribe, BUS_QUEUE)
        self._bus: Socket | None = bus
        self._previews: Socket | None = None
        self.sockets: tuple[Socket, ...] = (bus,)

    @property
    def bad(self) -> int:
        """How many pieces of garbage came so far."""
        return sum(self.bad_kinds.values())

    def subscribe(self, topic: Topic, *keys: str, every: bool = False) -> None:
        """Receive this topic; fewer keys than the topic has = all below. ``every``: of a ``latest`` topic too."""
        wire = topic.key(*keys)
        if every:
            self._whole.add(topic.name)
        if wire not in self._wanted:
            self._wanted.add(wire)
            self._routes.clear()
            self._lane(topic).setsockopt(zmq.SUBSCRIBE, wire)

    def unsubscribe(self, topic: Topic, *keys: str) -> None:
        """Undo ``subscribe`` with the same arguments; what was not subscribed to is ignored."""
        wire = topic.key(*keys)
        if wire in self._wanted:
            self._wanted.remove(wire)
            self._routes.clear()
            self._lane(topic).setsockopt(zmq.UNSUBSCRIBE, wire)

    def receive(self, max_age_s: float | None = None) -> list[Received]:
        """Everything that is there, in order of arrival, without waiting.

        Of a ``latest`` topic only the newest of each full key. Messages older than ``max_age_s`` are dropped
        and counted in ``stale``.
        """
        rows = self._arrived()
        # Nearly always there is one message: then nothing is newer, and nothing has to be put in order.
        found = self._all_valid(rows) if len(rows) < 2 else self._newest_and_every(rows)
        if max_age_s is None:
            return found
        fresh = []
        for received in found:
            if received.age_ns > max_age_s * 1e9:
                _add(self.stale, received.topic.name)
            else:
                fresh.append(received)
        return fresh

    def close(self) -> None:
        """Close at once; idempotent."""
        for made in self.sockets:
            made.close(linger=0)
        self._bus = self._previews = None
        self.sockets = ()

    def _all_valid(self, rows: list[_Row]) -> list[Received]:
        found = []
        for wire, route, data in rows:
            received = self._decoded(route, data)
            if received is not None:
                self._count_missed(wire, received)
                found.append(received)
        return found

    def _newest_and_every(self, rows: list[_Row]) -> list[Received]:
        newest: dict[bytes, list[tuple[int, _Row]]] = {}
        order: list[tuple[int, Received]] = []
        for position, row in enumerate(rows):
            topic = row[1][0]
            if topic.delivery == "latest" and topic.name not in self._whole:
                newest.setdefault(row[0], []).append((position, row))
            else:
                order += ((position, received) for received in self._all_valid([row]))
        order += (chosen for stack in newest.values() if (chosen := self._newest_valid(stack)) is not None)
        order.sort(key=lambda item: item[0])
        return [received for _, received in order]

    def _arrived(self) -> list[_Row]:
        rows = []
        for made in self.sockets:
            for parts in drain(made, _MAX_DRAIN):
                if len(parts) != 2:
                    self._count_bad("framing", f"{len(parts)} parts instead of topic and message")
                    continue
                wire, data = parts
                route = self._routes.get(wire) or self._route(wire)
                if route is not None:
                    rows.append((wire, route, data))
        return rows

    def _route(self, wire: bytes) -> _Route | None:
        """Topic and keys of a topic as it came, kept for the next message; None for what isn't wanted or isn't one."""
        topic = topic_of(wire)
        if topic is None or not has_valid_keys(topic, wire):
            self._count_bad("topic", f"no such topic: {wire[:80]!r}")
            return None
        # ZeroMQ matches prefixes: a subscription to camera/cam1 also brings camera/cam10.
        if wire not in self._wanted and not any(want.endswith(b"/") and wire.startswith(want) for want in self._wanted):
            return None
        route = topic, tuple(part.decode("ascii") for part in wire.split(b"/")[1:])
        if len(self._routes) < _MOST_ROUTES:
            self._routes[wire] = route
        return route

    def _newest_valid(self, stack: list[tuple[int, _Row]]) -> tuple[int, Received] | None:
        while stack:
            position, (wire, route, data) = stack.pop()
            received = self._decoded(route, data)
            if received is not None:
                if stack:
                    _add(self.superseded, route[0].name, len(stack))
                self._count_missed(wire, received, passed_over=len(stack))
                return position, received
        return None

    def _decoded(self, route: _Route, data: bytes) -> Received | None:
        topic, keys = route
        try:
            message = decode(topic.message, data)
        except CodecError as error:
            self._count_bad(f"message:{topic.name}", error.message)
            return None
        if message.stamp is None:
            self._count_bad(f"message:{topic.name}", "no stamp")
            return None
        return Received(topic, keys, message, message.stamp, clock.monotonic_ns())

    def _count_missed(self, wire: bytes, received: Received, passed_over: int = 0) -> None:
        topic, stamp = received.topic, received.stamp
        boot, seq = self._last.get(wire, ("", 0))
        gap = stamp.seq - seq - 1 - passed_over
        if boot == stamp.boot and gap > 0:
            _add(self.missed, topic.name, gap)
        self._last[wire] = (stamp.boot, stamp.seq)

    def _count_bad(self, kind: str, what: str) -> None:
        _add(self.bad_kinds, kind)
        if self.bad_kinds[kind] == 1:
            _LOG.warning("bus.garbage", kind=kind, what=what)

    def _lane(self, topic: Topic) -> Socket:
        if self._bus is None:
            raise ValueError("the subscriber is closed")
        if topic is not PREVIEW:
            return self._bus
        if self._previews is None:
            self._previews = _connect(self._endpoints.subscribe_preview, PREVIEW_QUEUE)
            self.sockets = (self._bus, self._previews)
        return self._previews


def _connect(address: str, queue: int) -> Socket:
    made = new_socket(zmq.SUB, {zmq.RCVHWM: queue, zmq.MAXMSGSIZE: 2 * (MAX_BYTES + ROOM_FOR_FRAMING)})
    made.connect(address)
    return made


def _add(counts: dict[str, int], what: str, by: int = 1) -> None:
    counts[what] = counts.get(what, 0) + by
