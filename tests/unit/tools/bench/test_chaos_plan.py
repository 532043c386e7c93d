"""The plan of a chaos run: what the seed promises."""

from __future__ import annotations

from collections import Counter

import pytest

from tools.bench.chaos.faults import CAUSES
from tools.bench.chaos.plan import KINDS, MINUTE, make_plan


def test_a_seed_repeats_its_plan_and_another_has_another() -> None:
    assert make_plan(7, 200) == make_plan(7, 200)
    assert make_plan(7, 200)[:50] == make_plan(7, 50), "a shorter run is the beginning of a longer one"
    assert make_plan(7, 50) != make_plan(8, 50)


@pytest.mark.parametrize("seed", range(1, 6))
def test_every_kind_comes_up_in_two_hundred_and_each_has_a_cause(seed: int) -> None:
    plan = make_plan(seed, 200)
    came = Counter(fault.kind for fault in plan)
    assert set(came) == set(CAUSES) == {kind.name for kind in (*KINDS, MINUTE)}
    assert came[MINUTE.name] == 2
    assert [fault.number for fault in plan] == list(range(200))
    for kind in (*KINDS, MINUTE):
        for fault in plan:
            if fault.kind == kind.name:
                assert fault.target in kind.targets
                assert kind.lasts_s[0] <= fault.lasts_s <= kind.lasts_s[1]


def test_kills_come_within_the_supervisors_startsecs() -> None:
    early = [fault for fault in make_plan(1, 200) if fault.kind == "kill -9 within startsecs"]
    assert len(early) > 5
    assert all(0 <= fault.amount < 3 for fault in early)


def test_the_short_form_has_the_cheap_faults_only() -> None:
    cheap = {kind.name for kind in KINDS if kind.short}
    assert {fault.kind for fault in make_plan(1, 60, short=True)} == cheap
