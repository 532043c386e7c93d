"""The rules of resending, with a clock of our own."""

from __future__ import annotations

import pytest

from common.bus.order_table import FRESH_NS, RESEND_NS, OrderTable
from common.errors import RefusedError


class Wire:
    """Takes what is sent while ``up``."""

    def __init__(self) -> None:
        self.up = True
        self.taken: list[bytes] = []

    def __call__(self, data: bytes) -> bool:
        if self.up:
            self.taken.append(data)
        return self.up


def table_of(*keys: str, window: int = 8) -> OrderTable:
    table = OrderTable(window)
    for key in keys:
        table.add(key, key.encode())
    return table


def test_each_order_goes_once() -> None:
    wire, table = Wire(), table_of("a", "b")
    table.flush(wire, 1)
    table.flush(wire, 2)
    assert wire.taken == [b"a", b"b"]


def test_a_repeated_key_is_the_same_order() -> None:
    table = table_of("a")
    assert not table.add("a", b"other")
    assert table.entries["a"].data == b"a"


def test_a_full_window_is_a_refusal() -> None:
    table = table_of("a", "b", window=2)
    with pytest.raises(RefusedError, match="2 orders") as caught:
        table.add("c", b"c")
    assert caught.value.code == "backlog_full"
    table.answered("a")
    assert table.add("c", b"c")


def test_what_could_not_go_goes_at_the_next_event_in_order() -> None:
    wire, table = Wire(), table_of("a", "b")
    wire.up = False
    table.flush(wire, 1)
    assert wire.taken == []
    wire.up = True
    assert table.peer_seen("x", wire, 2) == 0
    assert wire.taken == [b"a", b"b"]


def test_time_alone_resends_nothing() -> None:
    wire, table = Wire(), table_of("a")
    table.peer_seen("x", wire, 0)
    table.flush(wire, 100 * RESEND_NS)
    assert wire.taken == [b"a"]


def test_a_new_life_of_the_peer_gets_everything_again_once() -> None:
    wire, table = Wire(), table_of("a", "b")
    table.peer_seen("x", wire, 0)
    table.answered("a")
    assert table.peer_seen("y", wire, 1) == 1
    assert table.peer_seen("y", wire, 2) == 0
    assert wire.taken == [b"a", b"b", b"b"]


def test_a_living_peer_is_asked_again_after_ten_seconds_once_each_time() -> None:
    wire, table = Wire(), table_of("a")
    table.peer_seen("x", wire, 0)
    for second in range(1, 21):
        table.peer_seen("x", wire, second * 1_000_000_000)
    assert wire.taken == [b"a", b"a"]


def test_an_order_sent_before_the_peer_was_known_is_resent_once_it_is() -> None:
    wire, table = Wire(), table_of("a")
    table.flush(wire, 0)
    table.peer_seen("x", wire, 1)
    table.peer_seen("x", wire, 2)
    assert wire.taken == [b"a", b"a"]


def test_a_resend_that_fails_is_tried_at_the_next_sign_of_life() -> None:
    wire, table = Wire(), table_of("a", "b")
    table.peer_seen("x", wire, 0)
    wire.up = False
    assert table.peer_seen("y", wire, 1) == 0
    wire.up = True
    assert table.peer_seen("y", wire, 2) == 2


def test_freshness() -> None:
    table = table_of()
    assert not table.peer_is_fresh(0)
    table.peer_seen("x", Wire(), 0)
    assert table.peer_is_fresh(FRESH_NS)
    assert not table.peer_is_fresh(FRESH_NS + 1)


def test_an_answer_counts_once() -> None:
    table = table_of("a")
    assert table.answered("a")
    assert not table.answered("a")
