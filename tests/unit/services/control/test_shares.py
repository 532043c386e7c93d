"""Cameras are shared out evenly, keep their instance, and are learnt again after a restart of control."""

from __future__ import annotations

from collections import Counter

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.control.shares import Sharing

FUZZ = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
NAMES = st.lists(st.sampled_from([f"cam{number}" for number in range(12)]), unique=True)


def test_a_single_instance_serves_all() -> None:
    sharing = Sharing(1)
    assert sharing.share_out(["b", "a"])
    assert sharing.table == {"a": 0, "b": 0}


def test_new_cameras_go_to_the_least_busy_instance() -> None:
    sharing = Sharing(2)
    sharing.share_out(["a"])
    sharing.share_out(["a", "b"])
    sharing.share_out(["a", "b", "c"])
    assert sharing.table == {"a": 0, "b": 1, "c": 0}


def test_nothing_changes_without_a_new_camera() -> None:
    sharing = Sharing(3)
    sharing.share_out(["a", "b"])
    assert not sharing.share_out(["b", "a"])
    assert not sharing.share_out(["a"])
    assert sharing.table == {"a": 0, "b": 1}


def test_what_heartbeats_tell_is_kept_and_new_cameras_balance_it() -> None:
    sharing = Sharing(2)
    sharing.learn(1, ["a", "b", "c"])
    sharing.share_out(["a", "b", "c", "d", "e"])
    assert sharing.table == {"a": 1, "b": 1, "c": 1, "d": 0, "e": 0}


def test_a_second_claim_and_an_unknown_instance_change_nothing() -> None:
    sharing = Sharing(2)
    sharing.learn(0, ["a"])
    sharing.learn(1, ["a"])
    sharing.learn(7, ["b"])
    assert sharing.table == {"a": 0}
    assert sharing.instance("b") is None


@FUZZ
@given(st.integers(1, 5), st.lists(NAMES, max_size=6))
def test_shares_are_sticky_and_balanced(instances: int, rounds: list[list[str]]) -> None:
    sharing = Sharing(instances)
    for cameras in rounds:
        before = sharing.table
        sharing.share_out(cameras)
        assert {camera: sharing.table[camera] for camera in before} == before
        assert set(cameras) <= set(sharing.table)
        load = Counter(sharing.table.values())
        counts = [load[instance] for instance in range(instances)]
        assert max(counts) - min(counts) <= 1


@FUZZ
@given(st.integers(1, 4), NAMES)
def test_a_restarted_control_learns_the_same_table(instances: int, cameras: list[str]) -> None:
    first, second = Sharing(instances), Sharing(instances)
    first.share_out(cameras)
    for instance in reversed(range(instances)):
        second.learn(instance, [camera for camera in cameras if first.instance(camera) == instance])
    second.share_out(cameras)
    assert second.table == first.table
