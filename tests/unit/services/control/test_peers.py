"""Orders over real sockets: what a silent peer gets, and what it doesn't."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common import clock
from common.bus import Endpoints, OrderServer, Poller
from common.config.models import NetworkConfig
from common.errors import RefusedError
from common.messages import LabelOrder, StopOrder
from services.control.peers import Peers
from tests.unit.services.control.known import SECOND, service

ROUNDS = 100


@pytest.fixture
def endpoints() -> Endpoints:
    made = Endpoints.of(NetworkConfig())
    made.prepare()
    return made


@pytest.fixture
def label(endpoints: Endpoints) -> Iterator[OrderServer]:
    made = OrderServer(endpoints.orders_label(0), LabelOrder, "label.0")
    yield made
    made.close()


@pytest.fixture
def peers(endpoints: Endpoints, label: OrderServer) -> Iterator[Peers]:
    made = Peers(endpoints, 1)
    yield made
    made.close()


def stop(key: str) -> StopOrder:
    return StopOrder(key=key, recording="rec-a", camera="cam0")


def received(label: OrderServer, peers: Peers) -> list[str]:
    poller = Poller(label)
    for _ in range(ROUNDS):
        peers.receive()  # sends what couldn't go before there was a connection
        poller.wait(0.1)
        if orders := [order for _, order in label.receive()]:
            return [order.key for order in orders]
    raise AssertionError("nothing came")


def test_a_refused_order_never_reaches_a_peer_that_hangs(
    peers: Peers, label: OrderServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [clock.monotonic_ns()]
    monkeypatch.setattr(clock, "monotonic_ns", lambda: now[0])
    peers.heard(service("label.0"))
    peers.send("label.0", stop("connects"), lasting=True)
    assert received(label, peers) == ["connects"]
    now[0] += 4 * SECOND
    with pytest.raises(RefusedError) as refused:
        peers.send("label.0", stop("refused"))
    assert refused.value.code == "label_down"
    peers.send("label.0", stop("takes back"), lasting=True)
    assert received(label, peers) == ["takes back"], "the socket keeps the order: the refused one would have come first"
    assert peers.pending == 2
