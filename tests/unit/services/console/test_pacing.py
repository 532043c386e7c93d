"""A slow viewer gets smaller and fewer pictures, never a queue."""

from __future__ import annotations

import pytest

from services.console.pacing import CREDITS, GIVE_UP_NS, Pacing, divisor_for

MS = 1_000_000


@pytest.mark.parametrize(("wished", "divisor"), [(1, 4), (320, 4), (321, 2), (640, 2), (641, 1), (1280, 1), (5000, 1)])
def test_the_size_is_the_smallest_of_the_ladder_that_is_wide_enough(wished: int, divisor: int) -> None:
    assert divisor_for(1280, wished) == divisor


def test_two_pictures_are_under_way_at_most() -> None:
    pacing = Pacing(640)
    for seq in range(1, CREDITS + 1):
        assert pacing.ready(seq)
        pacing.sent(seq, seq)
    assert not pacing.ready(100)
    assert pacing.acknowledged(1, 200) == 199
    assert pacing.ready(201)
    assert pacing.acknowledged(1, 202) is None
    assert pacing.acknowledged(77, 203) is None


def test_an_acknowledgement_covers_those_before_it() -> None:
    pacing = Pacing(640)
    pacing.sent(1, 0)
    pacing.sent(2, 10)
    assert pacing.acknowledged(2, 20) == 10
    assert not pacing.under_way


def test_without_any_word_for_10_s_it_is_stuck() -> None:
    pacing = Pacing(640)
    assert not pacing.stuck(GIVE_UP_NS * 2)
    pacing.sent(1, 0)
    assert not pacing.stuck(GIVE_UP_NS)
    assert pacing.stuck(GIVE_UP_NS + 1)


def drawn(pacing: Pacing, took_ms: int, from_ms: int, seconds: int) -> int:
    """Pictures that each take ``took_ms``, for so long; returns when it ended (ms)."""
    now, end = from_ms, from_ms + seconds * 1000
    while now < end:
        seq = now
        pacing.sent(seq, now * MS)
        now += took_ms
        pacing.acknowledged(seq, now * MS)
    return now


def test_slow_acknowledgements_take_it_down_the_ladder_then_to_fewer_pictures_and_back_up() -> None:
    pacing = Pacing(1280)
    assert (pacing.divisor(1280), pacing.reduced) == (1, False)
    now = drawn(pacing, 200, 1, 3)
    assert (pacing.divisor(1280), pacing.reduced) == (2, True)
    now = drawn(pacing, 200, now, 2)
    assert pacing.divisor(1280) == 4
    now = drawn(pacing, 200, now, 4)
    assert pacing.divisor(1280) == 4
    assert pacing.slower >= 1
    pacing.sent(now, now * MS)
    pacing.acknowledged(now, now * MS + 1)
    assert not pacing.ready(now * MS + 20 * MS), "on the lowest rung fewer pictures"
    assert pacing.ready(now * MS + 3000 * MS)
    drawn(pacing, 30, now + 5000, 80)
    assert (pacing.divisor(1280), pacing.slower, pacing.reduced) == (1, 0, False)


def test_a_single_hiccup_changes_nothing() -> None:
    pacing = Pacing(1280)
    now = drawn(pacing, 30, 1, 3)
    pacing.sent(now, now * MS)
    pacing.acknowledged(now, (now + 900) * MS)
    drawn(pacing, 30, now + 900, 3)
    assert not pacing.reduced
