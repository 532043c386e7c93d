"""The runner's pure parts: states, liveness, meters, arguments."""

from __future__ import annotations

import itertools
import math
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import ConfigError, StateError
from common.messages import ServiceState
from common.messages.state import ServicePhase
from common.service import Liveness, Phase
from common.service.arguments import parse, service_id
from common.service.meters import Percentiles, Rate, Tally
from common.service.states import TRANSITIONS, StateMachine

S = 1_000_000_000


# --- states -----------------------------------------------------------------------------------------------


def test_the_table_has_every_phase_and_the_messages_words() -> None:
    assert set(TRANSITIONS) == set(Phase)
    assert {phase.value for phase in Phase} == set(get_args(ServicePhase))


@given(st.lists(st.sampled_from(list(Phase)), max_size=8))
def test_only_steps_of_the_table_are_taken(steps: list[Phase]) -> None:
    machine = StateMachine()
    for step in steps:
        before = machine.phase
        if step is before:
            assert not machine.enter(step)
        elif step in TRANSITIONS[before]:
            assert machine.enter(step)
        else:
            with pytest.raises(StateError, match=f"that is {before}"):
                machine.enter(step)
            assert machine.phase is before


def test_from_everywhere_the_end_can_be_reached_and_nothing_follows_it() -> None:
    assert all(Phase.STOPPED in TRANSITIONS[phase] for phase in Phase if phase is not Phase.STOPPED)
    assert TRANSITIONS[Phase.STOPPED] == frozenset()


# --- liveness ---------------------------------------------------------------------------------------------


def state(service: str, boot: str = "a", phase: ServicePhase = "running") -> ServiceState:
    return ServiceState(service=service, boot=boot, pid=1, phase=phase)


def test_silence_of_three_seconds_is_missing() -> None:
    liveness = Liveness()
    assert liveness.feed(state("store"), 0)
    assert liveness.is_alive("store", 3 * S)
    assert liveness.missing(3 * S) == ()
    assert not liveness.is_alive("store", 3 * S + 1)
    assert liveness.missing(3 * S + 1) == ("store",)


def test_a_good_bye_is_not_missing() -> None:
    liveness = Liveness()
    liveness.feed(state("store", phase="stopped"), 0)
    assert not liveness.is_alive("store", 0)
    assert liveness.missing(100 * S) == ()


def test_restarts_are_seen_by_the_boot() -> None:
    liveness = Liveness()
    assert [liveness.feed(state("store", boot), 0) for boot in "aabbc"] == [True, False, True, False, True]
    assert liveness.seen()["store"].restarts == 2


def test_who_is_alive_is_sorted_and_the_unknown_is_not() -> None:
    liveness = Liveness()
    for name in ("store", "capture.cam1", "capture.cam0"):
        liveness.feed(state(name), 0)
    assert [found.service for found in liveness.alive(0)] == ["capture.cam0", "capture.cam1", "store"]
    assert not liveness.is_alive("nobody", 0)
    liveness.forget("store")
    liveness.forget("store")
    assert liveness.missing(100 * S) == ("capture.cam0", "capture.cam1")


# --- meters -----------------------------------------------------------------------------------------------


def test_a_steady_rate() -> None:
    rate = Rate(window_s=5)
    for number in range(300):
        rate.mark(now_ns=number * S // 30)
    assert rate.per_second(now_ns=10 * S) == pytest.approx(30, rel=0.02)
    assert rate.per_second(now_ns=100 * S) == 0


def test_a_young_rate_is_not_exaggerated() -> None:
    rate = Rate()
    assert rate.per_second(now_ns=5 * S) == 0
    rate.mark(10, now_ns=5 * S)
    assert rate.per_second(now_ns=5 * S + 1) == 10


def test_a_tally() -> None:
    tally = Tally()
    tally.add("late")
    tally.add("late", 2)
    tally.add("torn")
    assert (tally["late"], tally["never"], tally.total) == (3, 0, 4)
    copy = tally.as_dict()
    copy["late"] = 99
    assert tally.as_dict() == {"late": 3, "torn": 1}


def test_percentiles_by_nearest_rank() -> None:
    values = Percentiles(size=100)
    assert math.isnan(values.at(50))
    for value in range(1, 201):
        values.add(value)
    assert len(values) == 100
    assert [values.at(percent) for percent in (0, 1, 50, 99, 100)] == [101, 101, 150, 199, 200]


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=50), st.floats(0, 100))
def test_a_percentile_is_one_of_the_values(values: list[float], percent: float) -> None:
    percentiles = Percentiles()
    for value in values:
        percentiles.add(value)
    assert percentiles.at(percent) in values


# --- arguments --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "more", "expected"),
    [
        ("capture", ("--camera", "cam0"), "capture.cam0"),
        ("detect", (), "detect.0"),
        ("label", ("--instance", "2"), "label.2"),
        ("store", (), "store"),
        ("control", ("--instance", "3"), "control"),
    ],
)
def test_service_ids(name: str, more: tuple[str, ...], expected: str) -> None:
    assert service_id(name, parse(name, ("--rig", "r.yaml", *more))) == expected


MISTAKES = [
    (),
    ("--rig",),
    ("--rig", "r", "--instance", "x"),
    ("--rig", "r", "--instance", "100"),
    ("--rig", "r", "--instance", "-1"),
    ("--rig", "r", "--unknown"),
    ("--rig", "r", "more"),
    ("--rig", "r", "--log-level", "loud"),
]


@pytest.mark.parametrize(("name", "argv"), list(itertools.product(["store"], MISTAKES)))
def test_a_mistake_on_the_command_line_is_one_of_the_configuration(name: str, argv: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="command line"):
        parse(name, argv)


def test_capture_needs_a_camera() -> None:
    with pytest.raises(ConfigError, match="--camera"):
        service_id("capture", parse("capture", ("--rig", "r")))
