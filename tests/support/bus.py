"""Publishers and subscribers for tests."""

from __future__ import annotations

from contextlib import ExitStack, closing

from common.bus import Endpoints, Poller, Publisher, Received, Subscriber
from common.messages import Shares
from common.topics import SHARES, Topic
from tests.support.stack import wait_for


class Bus:
    """Makes connected publishers and subscribers, and closes them."""

    def __init__(self, endpoints: Endpoints, closers: ExitStack) -> None:
        self.endpoints = endpoints
        self._closers = closers

    def publisher(self, source: str = "test", boot: str = "b1") -> Publisher:
        return self._closers.enter_context(closing(Publisher(self.endpoints, source, boot)))

    def subscriber(self, *topics: Topic) -> Subscriber:
        made = self._closers.enter_context(closing(Subscriber(self.endpoints)))
        for topic in topics:
            made.subscribe(topic)
        return made

    def connect(self, publisher: Publisher, subscriber: Subscriber) -> None:
        """Return once what ``publisher`` sends reaches ``subscriber``: a first message made the way."""
        subscriber.subscribe(SHARES)
        poller = Poller(subscriber)

        def through() -> bool:
            publisher.publish(SHARES, (), Shares(detect={}, label={}))
            poller.wait(0.02)
            return any(received.topic is SHARES for received in subscriber.receive())

        wait_for(through, 20, "the bus to connect")
        subscriber.unsubscribe(SHARES)
        subscriber.receive()
        subscriber.missed.clear()  # probes may be lost while the way is being made


def collect(subscriber: Subscriber, count: int, deadline_s: float = 20) -> list[Received]:
    """Receive until ``count`` messages are there."""
    poller = Poller(subscriber)
    got: list[Received] = []

    def enough() -> bool:
        poller.wait(0.1)
        got.extend(subscriber.receive())
        return len(got) >= count

    wait_for(enough, deadline_s, f"{count} messages")
    return got
