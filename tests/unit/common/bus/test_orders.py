"""Orders between two sockets: exactly one answer, garbage counted, nothing stolen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from threading import Thread

import msgpack
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.bus import Endpoints, OrderClient, OrderServer, Poller, Return, order_server
from common.bus.sockets import GOODBYE
from common.errors import NameTakenError, RefusedError
from common.messages import (
    MAX_BYTES,
    Answer,
    LedgerQuery,
    Order,
    RecordOrder,
    ReloadOrder,
    SessionOrder,
    StoreSideOrder,
    encode,
)
from tests.support.stack import wait_for


@pytest.fixture
def server(endpoints: Endpoints, monkeypatch: pytest.MonkeyPatch) -> Iterator[OrderServer]:
    monkeypatch.setattr(order_server, "_GOODBYE_NS", 0)
    with closing(OrderServer(endpoints.orders_store, StoreSideOrder, "store")) as made:
        yield made


@pytest.fixture
def connect(endpoints: Endpoints) -> Iterator[Callable[..., OrderClient]]:
    with ExitStack() as closers:

        def made(identity: str = "label.0", window: int = 64, *, wait: bool = True) -> OrderClient:
            client = closers.enter_context(closing(OrderClient(endpoints.orders_store, identity, window)))
            if wait:
                client.peer_seen("s1")
                wait_for(lambda: client.available, 10, "the connection")
            return client

        yield made


@pytest.fixture
def raw(endpoints: Endpoints) -> Iterator[zmq.Socket[bytes]]:
    made = zmq.Context.instance().socket(zmq.DEALER)
    made.linger = 0
    made.connect(endpoints.orders_store)
    yield made
    made.close()


def orders(server: OrderServer, count: int = 1) -> list[tuple[Return, Order]]:
    poller, got = Poller(server), list[tuple[Return, Order]]()
    wait_for(lambda: got.extend(server.receive()) or len(got) >= count or (poller.wait(0.05) and False), 10, "orders")
    return got


def answers(client: OrderClient, count: int = 1) -> list[Answer]:
    poller, got = Poller(client), list[Answer]()
    wait_for(lambda: got.extend(client.receive()) or len(got) >= count or (poller.wait(0.05) and False), 10, "answers")
    return got


def test_a_server_goes_when_its_last_answers_are_read(
    endpoints: Endpoints, connect: Callable[..., OrderClient], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(order_server, "_GOODBYE_NS", 60_000_000_000)
    server = OrderServer(endpoints.orders_store, StoreSideOrder)
    client = connect()
    for number in range(20):
        client.send(SessionOrder(key=f"k{number}", name="monday"))
    for back, order in orders(server, 20):
        server.answer(back, Answer(key=order.key, text="opened"))
    going = Thread(target=server.close)
    going.start()
    going.join(0.2)
    assert len(answers(client, 20)) == 20
    going.join()


def test_a_server_does_not_wait_for_ever_and_what_was_not_read_is_asked_again(
    endpoints: Endpoints, connect: Callable[..., OrderClient]
) -> None:
    server = OrderServer(endpoints.orders_store, StoreSideOrder)
    client = connect()
    client.send(SessionOrder(key="k", name="monday"))
    [(back, _)] = orders(server)
    server.answer(back, Answer(key="k", text="opened"))
    server.close()
    server.close()
    wait_for(lambda: not client.available, 10, "the connection's end")
    with closing(OrderServer(endpoints.orders_store, StoreSideOrder)) as second:

        def answered() -> list[Answer]:
            client.peer_seen("s2")
            for return_, order in second.receive():
                second.answer(return_, Answer(key=order.key, text="opened"))
            return client.receive()

        assert wait_for(answered, 10, "the answer") == [Answer(key="k", text="opened")]
        assert client.pending == ()


def test_an_order_is_answered_once(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    client = connect()
    order = SessionOrder(key="k", name="monday")
    client.send(order)
    assert client.pending == ("k",)
    [(back, came)] = orders(server)
    assert came == order
    for _ in range(2):
        server.answer(back, Answer(key="k", text="opened"))
    assert answers(client) == [Answer(key="k", text="opened")]
    assert client.pending == ()
    wait_for(lambda: client.receive() == [] and client.repeated == 1, 10, "the repeated answer")


def test_answers_find_their_client(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    clients = [connect(f"label.{number}") for number in range(3)]
    for number, client in enumerate(clients):
        client.send(LedgerQuery(key=f"k{number}"))
    for back, order in orders(server, 3):
        server.answer(back, Answer(key=order.key, text=back.identity.decode()))
    for number, client in enumerate(clients):
        assert answers(client) == [Answer(key=f"k{number}", text=f"label.{number}")]


def test_a_repeated_order_is_handed_over_again(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    client = connect()
    client.send(LedgerQuery(key="k"))
    assert len(orders(server)) == 1
    client.peer_seen("s2")
    [(back, order)] = orders(server)
    assert (order.key, client.resent) == ("k", 1)
    server.answer(back, Answer(key="k"))
    assert len(answers(client)) == 1


def test_without_a_server_the_order_waits_and_goes_when_it_comes(
    endpoints: Endpoints, connect: Callable[..., OrderClient]
) -> None:
    client = connect(wait=False)
    client.peer_seen("s1")
    assert not client.available
    client.send(LedgerQuery(key="early"))
    with closing(OrderServer(endpoints.orders_store, StoreSideOrder)) as server:
        wait_for(lambda: client.available, 10, "the connection")
        client.receive()
        [(back, order)] = orders(server)
        server.answer(back, Answer(key=order.key))
        assert [answer.key for answer in answers(client)] == ["early"]
        assert client.resent == 0


def test_a_full_window_refuses_at_once(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    client = connect(window=3)
    for number in range(3):
        client.send(LedgerQuery(key=f"k{number}"))
    client.send(LedgerQuery(key="k1"))
    with pytest.raises(RefusedError) as caught:
        client.send(LedgerQuery(key="k3"))
    assert caught.value.code == "backlog_full"
    client.forget("k0")
    client.send(LedgerQuery(key="k3"))
    assert client.pending == ("k1", "k2", "k3")


def test_a_thousand_orders_have_a_thousand_answers(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    client, poller = connect(window=64), Poller(server)
    poller.add(client)
    got: list[str] = []
    sent = 0

    def all_answered() -> bool:
        nonlocal sent
        while sent < 1000 and len(client.pending) < 64:
            client.send(LedgerQuery(key=f"k{sent}"))
            sent += 1
        poller.wait(0.05)
        for back, order in server.receive():
            server.answer(back, Answer(key=order.key))
        got.extend(answer.key for answer in client.receive())
        return len(got) == 1000

    wait_for(all_answered, 30, "1000 answers")
    assert got == [f"k{number}" for number in range(1000)]
    assert (server.unreachable, server.bad, client.repeated, client.resent) == (0, 0, 0, 0)


def test_an_answer_to_one_who_left_is_counted(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    client = connect()
    client.send(LedgerQuery(key="k"))
    [(back, _)] = orders(server)
    client.close()
    client.close()

    def unreachable() -> bool:
        server.answer(back, Answer(key="k"))
        return server.unreachable > 0

    wait_for(unreachable, 10, "the loss to be seen")


def test_a_restarted_client_takes_its_identity_over(server: OrderServer, connect: Callable[..., OrderClient]) -> None:
    first = connect("label.0")
    first.send(LedgerQuery(key="old"))
    [(back, _)] = orders(server)
    second = connect("label.0")  # the first is still connected, as a stopped process would be
    second.send(LedgerQuery(key="new"))
    [(also_back, order)] = orders(server)
    assert (also_back, order.key) == (back, "new")
    server.answer(back, Answer(key="old"))
    server.answer(back, Answer(key="new"))
    assert [answer.key for answer in answers(second)] == ["new"]
    assert second.repeated == 1


def test_a_second_server_is_refused_and_steals_nothing(
    server: OrderServer, endpoints: Endpoints, connect: Callable[..., OrderClient]
) -> None:
    with pytest.raises(NameTakenError, match=r"orders-store is held by store \(pid \d+\)"):
        OrderServer(endpoints.orders_store, StoreSideOrder, "thief")
    client = connect()
    client.send(LedgerQuery(key="k"))
    assert len(orders(server)) == 1


def test_closing_leaves_nothing_and_a_successor_keeps_its_file(endpoints: Endpoints) -> None:
    for _ in range(20):
        first = OrderServer(endpoints.orders_store, StoreSideOrder)
        first.close()
        with closing(OrderServer(endpoints.orders_store, StoreSideOrder)) as second:
            first.close()
            assert sorted(path.name for path in endpoints.run_dir.iterdir()) == ["orders-store", "orders-store.lock"]
            assert second.sockets
    assert list(endpoints.run_dir.iterdir()) == []


@pytest.mark.parametrize(
    "plain",
    [
        {"key": "k", "kind": "unknown"},
        {"key": "k", "kind": ["session"]},
        {"key": "k"},
        {"key": "k", "kind": "session"},
        {"key": "k", "kind": "session", "name": 5},
        {"key": "k", "kind": "session", "name": "n", "more": 1},
        {"key": "k", "kind": "record", "recording": "r", "camera": "c"},
    ],
)
def test_a_wrong_order_with_a_key_is_answered(
    server: OrderServer, raw: zmq.Socket[bytes], plain: dict[str, object]
) -> None:
    raw.send(msgpack.packb(plain))
    wait_for(lambda: server.receive() == [] and server.bad == 1, 10, "the order")
    assert raw.poll(5000)
    answer = msgpack.unpackb(raw.recv())
    assert (answer["key"], answer["error"]["code"]) == ("k", "bad_order")


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(parts=st.lists(st.binary(max_size=100).filter(lambda part: part != GOODBYE), min_size=1, max_size=4))
def test_garbage_is_counted_and_changes_nothing(
    server: OrderServer, raw: zmq.Socket[bytes], parts: list[bytes]
) -> None:
    before = server.bad
    raw.send_multipart(parts)
    wait_for(lambda: server.receive() == [] and server.bad == before + 1, 10, "the garbage to be counted")


def test_garbage_answers_do_not_disturb_the_client(endpoints: Endpoints) -> None:
    fake = zmq.Context.instance().socket(zmq.ROUTER)
    fake.linger = 0
    fake.bind(endpoints.orders_store)
    with closing(fake), closing(OrderClient(endpoints.orders_store, "label.0")) as client:
        client.peer_seen("s1")
        wait_for(lambda: client.available, 10, "the connection")
        client.send(LedgerQuery(key="k"))
        assert fake.poll(5000)
        identity, _ = fake.recv_multipart()
        for data in (b"", b"\xc1", msgpack.packb({"key": 5}), msgpack.packb([1]), encode(Answer(key="other"))):
            fake.send_multipart([identity, data])
        fake.send_multipart([identity, encode(Answer(key="k"))])
        assert [answer.key for answer in answers(client)] == ["k"]
        assert (client.bad, client.repeated) == (4, 1)
    (endpoints.run_dir / "orders-store").unlink()


def test_an_oversized_order_costs_its_sender_the_connection(
    server: OrderServer, raw: zmq.Socket[bytes], connect: Callable[..., OrderClient]
) -> None:
    raw.send(b"x" * (2 * MAX_BYTES))
    client = connect()
    client.send(LedgerQuery(key="k"))
    [(_, order)] = orders(server)
    assert (order.key, server.bad) == ("k", 0)


def test_only_the_named_kinds_are_taken(endpoints: Endpoints, raw: zmq.Socket[bytes]) -> None:
    with closing(OrderServer(endpoints.orders_store, (ReloadOrder, LedgerQuery))) as server:
        raw.send(encode(RecordOrder(key="r", recording="r", camera="c")))
        raw.send(encode(ReloadOrder(key="k")))
        assert [order for _, order in orders(server)] == [ReloadOrder(key="k")]
        assert server.bad == 1
