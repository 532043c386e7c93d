"""Frames come at a steady pace, samples leave at a slower one: which frames are taken?"""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.label.thinning import Thinning, reserved


def run(slots: int, frames: int, leave: float, thinning: Thinning | None = None) -> tuple[list[int], int]:
    """Of ``frames`` frames those that are taken, while ``leave`` samples leave for each frame; the most that waited."""
    thinning = thinning or Thinning(slots)
    taken: list[int] = []
    waiting = most = 0
    owed = 0.0
    for frame in range(frames):
        if thinning.takes(slots - waiting):
            taken.append(frame)
            waiting += 1
        most = max(most, waiting)
        owed += leave
        gone = min(int(owed), waiting)
        owed, waiting = owed - int(owed), waiting - gone
    return taken, most


@pytest.mark.parametrize("slots", [1, 2, 3, 8, 64])
def test_who_keeps_up_leaves_nothing_out(slots: int) -> None:
    taken, _ = run(slots, 1000, 1.0)
    assert len(taken) == 1000


def test_a_short_pause_is_buffered_whole() -> None:
    taken, _ = run(64, 45, 0.0)
    assert len(taken) == 45


@pytest.mark.parametrize("leave", [0.9, 2 / 3, 0.5, 0.34, 0.2, 0.05])
def test_a_lasting_lack_is_spread_evenly(leave: float) -> None:
    taken, most = run(64, 6000, leave)
    settled = [frame for frame in taken if frame >= 3000]
    gaps = {later - earlier for earlier, later in itertools.pairwise(settled)}
    assert max(gaps) <= 1 / leave + 2, "no hole"
    assert max(gaps) - min(gaps) <= max(2, 0.25 / leave), "and no bunch"
    assert len(settled) == pytest.approx(3000 * leave, rel=0.02), "all that the disk can take"
    assert most <= 64 - reserved(64)


def test_it_is_over_when_the_buffer_is_half_empty() -> None:
    thinning = Thinning(64)
    run(64, 600, 0.5, thinning)
    assert thinning.active
    assert thinning.takes(64 - 40)
    assert thinning.active
    assert thinning.takes(64 - 20)
    assert not thinning.active
    assert all(thinning.takes(64 - 20) for _ in range(10))


@given(st.integers(1, 300), st.floats(0.0, 1.5), st.integers(1, 400))
def test_a_single_request_always_finds_its_slots(slots: int, leave: float, frames: int) -> None:
    _, most = run(slots, frames, leave)
    assert most <= slots - reserved(slots)
    assert reserved(slots) == 0 if slots < 3 else 1 <= reserved(slots) < slots
