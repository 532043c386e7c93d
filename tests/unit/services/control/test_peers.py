"""Orders over real sockets: what a silent peer gets, and what it doesn't."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from common import clock
from common.bus import Endpoints, OrderServer, Poller, Return
from common.config.models import NetworkConfig
from common.errors import RefusedError
from common.messages import Answer, LabelOrder, StopOrder
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


def taken(label: OrderServer, peers: Peers) -> list[tuple[Return, str]]:
    poller = Poller(label)
    for _ in range(ROUNDS):
        peers.receive()  # sends what couldn't go before there was a connection
        poller.wait(0.1)
        if orders := label.receive():
            return [(return_, order.key) for return_, order in orders]
    raise AssertionError("nothing came")


def received(label: OrderServer, peers: Peers) -> list[str]:
    return [key for _, key in taken(label, peers)]


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


@pytest.mark.parametrize("boot", ["b1", "b2"])
def test_an_answered_order_is_not_given_again(
    peers: Peers, label: OrderServer, monkeypatch: pytest.MonkeyPatch, boot: str
) -> None:
    now = [clock.monotonic_ns()]
    monkeypatch.setattr(clock, "monotonic_ns", lambda: now[0])
    peers.heard(service("label.0", "b1"))
    peers.send("label.0", stop("once"), lasting=True)
    ((return_, key),) = taken(label, peers)
    label.answer(return_, Answer(key=key))
    assert Poller(*peers.clients).wait(10), "the answer is there before the state is heard"
    now[0] += 11 * SECOND
    peers.heard(service("label.0", boot))
    assert peers.resent == 0
    assert [answer.key for answer in peers.receive()] == ["once"]
    assert peers.pending == 0
