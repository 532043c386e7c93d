"""Who was refused is told, and telling it can't fill a disk."""

from __future__ import annotations

import pytest

from common import clock
from common.refusals import EVERY_S, MOST_LINES, Refusals


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The clock, to be moved by hand."""
    time_ns = [10**12]
    monkeypatch.setattr(clock, "monotonic_ns", lambda: time_ns[0])
    return time_ns


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line for line in capsys.readouterr().err.splitlines() if "door.refused" in line]


def test_the_first_refusal_is_told_at_once_and_those_after_it_in_one_line(
    now: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    refusals = Refusals("door.refused")
    for _ in range(1000):
        refusals.note("192.0.2.7", "no key")
    (first,) = lines(capsys)
    assert "192.0.2.7" in first
    assert "no key" in first
    now[0] += int(EVERY_S * 1e9)
    refusals.note("192.0.2.7", "no key")
    (second,) = lines(capsys)
    assert "times=1000" in second.replace("\x1b[35m", "").replace("\x1b[0m", "")
    assert refusals.total == 1001


def test_a_flood_from_many_addresses_has_few_lines(now: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    refusals = Refusals("door.refused")
    for number in range(5000):
        refusals.note(f"192.0.2.{number}", "no key")
    assert len(lines(capsys)) == MOST_LINES
    now[0] += int(EVERY_S * 1e9)
    refusals.note("198.51.100.1", "no key")
    assert len(lines(capsys)) == 1
    assert refusals.total == 5001
