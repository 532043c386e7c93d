"""Waiting."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator

import pytest

from common.bus import Poller, Proxy
from common.messages import Shares
from common.topics import DETECTIONS, PREVIEW, SHARES
from tests.support.bus import Bus
from tests.support.stack import wait_for


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)
    os.close(writing)


def test_a_connected_socket_with_nothing_to_read_is_no_reason_to_wake(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    assert not Poller(subscriber).wait(0.05)


def test_a_message_wakes(bus: Bus, proxy: Proxy) -> None:
    publisher, subscriber = bus.publisher(), bus.subscriber(DETECTIONS)
    bus.connect(publisher, subscriber)
    subscriber.subscribe(SHARES)
    poller = Poller(subscriber)

    def woken() -> bool:
        publisher.publish(SHARES, (), Shares(detect={}, label={}))
        return poller.wait(0.05)

    wait_for(woken, 10, "the poller")


def test_a_socket_that_its_owner_opens_later_is_waited_for(bus: Bus) -> None:
    subscriber = bus.subscriber()
    poller = Poller(subscriber)
    poller.wait(0)
    subscriber.subscribe(PREVIEW)
    assert len(subscriber.sockets) == 2
    assert not poller.wait(0.01)


def test_pipes_and_descriptors_can_be_members(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    poller = Poller(reading)
    assert not poller.wait(0)
    os.write(writing, b"x")
    assert poller.wait(5)
    poller.remove(reading)
    assert not poller.wait(0)
    here, there = multiprocessing.Pipe()
    with here, there:
        poller.add(here)
        there.send(1)
        assert poller.wait(5)


def test_a_poller_without_members_waits_too() -> None:
    before = time.monotonic()
    assert not Poller().wait(0.05)
    assert time.monotonic() - before >= 0.05


def test_a_closed_member_is_left_out(bus: Bus) -> None:
    subscriber = bus.subscriber()
    poller = Poller(subscriber)
    poller.wait(0)
    subscriber.close()
    assert not poller.wait(0)
