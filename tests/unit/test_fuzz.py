"""Hostile input, for seconds: each parser refuses it in its own words or takes it; see tests/fuzz."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS, Target


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@settings(deadline=None, max_examples=40, suppress_health_check=list(HealthCheck))
@given(number=st.integers(0, 2**32))
def test_nothing_crashes_a_parser(target: Target, number: int, tmp_path: Path) -> None:
    target(tmp_path, mutated(target, number))


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_the_seeds_are_what_the_parser_reads(target: Target, tmp_path: Path) -> None:
    for seed in target.seeds:
        target(tmp_path, seed)
