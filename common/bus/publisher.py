"""Publishing messages; never blocks."""

from __future__ import annotations

import zmq

from common import clock
from common.bus.endpoints import Endpoints
from common.bus.keyparts import has_valid_keys
from common.bus.sockets import PREVIEW_QUEUE, PUBLISHER_QUEUE, Socket, new_socket, send_pair
from common.messages import Message, encode_stamped
from common.topics import PREVIEW, Topic


class Publisher:
    """Publishes as ``source`` (a service id) in the life ``boot``. One a thread.

    ``dropped`` counts messages that found the queue to the bus full (the proxy is down or stopped).
    """

    def __init__(self, endpoints: Endpoints, source: str, boot: str) -> None:
        self.dropped = 0
        self._endpoints = endpoints
        self._source = source
        self._boot = boot
        self._sent: dict[bytes, int] = {}
        self._wires: dict[tuple[str, tuple[str, ...]], bytes] = {}
        self._bus: Socket | None = _connect(endpoints.publish, PUBLISHER_QUEUE)
        self._previews: Socket | None = None

    def publish(self, topic: Topic, keys: tuple[str, ...], message: Message) -> None:
        """Stamp and send ``message``; ``keys`` are all of the topic's key parts.

        The stamp's ``seq`` counts the messages of this topic and key, so that a reader sees what it missed.
        Raises TypeError for a message of another topic, ValueError for incomplete keys, CodecError if too large.
        """
        if type(message) is not topic.message:
            raise TypeError(f"topic {topic.name} takes {topic.message.__name__}, not {type(message).__name__}")
        wire = self._wires.get((topic.name, keys)) or self._wire(topic, keys)
        seq = self._sent.get(wire, 0) + 1
        data = encode_stamped(message, self._source, self._boot, seq, clock.monotonic_ns(), clock.wall_ns())
        self._sent[wire] = seq
        if not _sent(self._lane(topic), wire, data):
            self.dropped += 1

    def close(self, linger_s: float = 0.0) -> None:
        """Close at once, or let the end of the process wait ``linger_s`` for last words. Idempotent."""
        for made in (self._bus, self._previews):
            if made is not None:
                made.close(linger=int(linger_s * 1000))
        self._bus = self._previews = None

    def _wire(self, topic: Topic, keys: tuple[str, ...]) -> bytes:
        """The topic as it is sent, kept for the next message."""
        wire = topic.key(*keys)
        if not has_valid_keys(topic, wire):
            raise ValueError(f"topic {topic.name} needs names for the keys {topic.keys}, got {keys}")
        self._wires[topic.name, keys] = wire
        return wire

    def _lane(self, topic: Topic) -> Socket:
        if self._bus is None:
            raise ValueError(f"the publisher of {self._source} is closed")
        if topic is not PREVIEW:
            return self._bus
        if self._previews is None:
            self._previews = _connect(self._endpoints.publish_preview, PREVIEW_QUEUE)
        return self._previews


def _sent(lane: Socket, wire: bytes, data: bytes) -> bool:
    """Whether the two found room in the queue."""
    for _ in range(2):
        try:
            send_pair(lane, wire, data)
            return True
        except zmq.Again:
            # ZeroMQ looks for acknowledgements at most once a millisecond, so a burst finds a queue full that
            # is empty; asking for the socket's events makes it look now.
            lane.getsockopt(zmq.EVENTS)
    return False


def _connect(address: str, queue: int) -> Socket:
    # XPUB_NODROP: a full queue is an error that can be counted, instead of a silent loss.
    made = new_socket(zmq.PUB, {zmq.SNDHWM: queue, zmq.XPUB_NODROP: 1})
    made.connect(address)
    return made
