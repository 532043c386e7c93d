from __future__ import annotations

import pytest

from common.laps import StepMeans, Stopwatch


def test_a_step_that_comes_again_adds_up() -> None:
    watch = Stopwatch()
    for step in ("read", "work", "read"):
        sum(range(20_000))
        watch.lap(step)
    assert list(watch.laps) == ["read", "work"]
    assert all(cpu > 0 and wall > 0 for wall, cpu in watch.laps.values())


def test_means_are_of_the_newest() -> None:
    means = StepMeans(size=2)
    assert means.as_numbers() == {}
    for wall in (100.0, 2.0, 4.0):
        means.add({"write": (wall, wall / 2)})
    means.add({})
    assert means.as_numbers() == pytest.approx({"write_ms": 3.0, "write_cpu_ms": 1.5})
    for wall in (1.5, 2.5, 0.25, 0.75):
        means.add({"write": (wall, wall / 2)})
    assert means.as_numbers() == pytest.approx({"write_ms": 0.5, "write_cpu_ms": 0.25}), (
        "nothing of the older ones stays"
    )
