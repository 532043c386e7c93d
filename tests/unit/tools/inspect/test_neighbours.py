"""Samples against those before and after them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tools.inspect.facts import Facts, ObjectFacts
from tools.inspect.neighbours import neighbour_reasons

STEP_NS = 200_000_000


def sample(number: int, *windows: tuple[str, float]) -> Facts:
    """A sample whose objects' windows begin at these places."""
    objects = tuple(
        ObjectFacts(
            name=name,
            type="box",
            class_name="front",
            distance_mm=700.0,
            angle_deg=10.0,
            azimuth_deg=0.0,
            elevation_deg=10.0,
            window=np.array([x, 100.0, x + 120.0, 200.0]),
            pose=np.eye(4),
            whole=True,
            residual_px=0.1,
            corner_sigma_px=None,
            distance_sigma_mm=None,
            ambiguous=False,
            off_px=0.0,
            wrong=(),
            depth_mm=None,
            depth_signed_mm=None,
            outline=None,
            pattern=0.0,
            pattern_marker=None,
            erased=0.1,
        )
        for name, x in windows
    )
    return Facts(f"s{number:03d}", "cam0", readable=True, wall_ns=number * STEP_NS, objects=objects)


def kinds(facts: list[Facts]) -> dict[int, list[str]]:
    return {index: [one.kind for one in reasons] for index, reasons in neighbour_reasons(facts).items()}


def test_a_window_that_jumps_is_found_and_its_neighbours_are_not_blamed() -> None:
    facts = [sample(number, ("box", 50.0 + 4 * number + (60.0 if number == 7 else 0.0))) for number in range(20)]
    assert kinds(facts) == {7: ["jump"]}
    assert kinds(facts[::-1]) == {12: ["jump"]}, "the order of the samples doesn't matter"


def test_two_jumps_beside_each_other_are_both_found() -> None:
    off = {7: 60.0, 8: -80.0}
    facts = [sample(number, ("box", 50.0 + 4 * number + off.get(number, 0.0))) for number in range(20)]
    assert kinds(facts) == {7: ["jump"], 8: ["jump"]}


def test_views_that_are_far_apart_have_no_neighbours() -> None:
    random = np.random.default_rng(1)
    facts = [sample(number, ("box", float(random.uniform(0, 500)))) for number in range(60)]
    assert kinds(facts) == {}


def test_an_object_that_is_gone_for_one_sample_is_missed() -> None:
    facts = [sample(number, ("a", 50.0 + number), ("b", 300.0)) for number in range(9)]
    facts[4] = replace(facts[4], objects=facts[4].objects[:1])
    assert kinds(facts) == {4: ["vanished"]}
    facts[4] = replace(facts[4], background=True)
    assert kinds(facts) == {}


def test_few_samples_say_nothing() -> None:
    for count in range(3):
        assert kinds([sample(number, ("box", 100.0 * number)) for number in range(count)]) == {}
