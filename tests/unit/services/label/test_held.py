"""Samples that wait for the frames after them."""

from __future__ import annotations

import numpy as np

from common.labels import CameraLabel
from services.label.finish import Job
from services.label.held import Held, Wait, worth_waiting
from services.label.labelling import Around
from services.label.sightings import GAP_NS, Expected, Sighting
from tests.unit.services.label.truth import looking_at

MS = 1_000_000
MOMENT = 1000 * MS
CAMERA = CameraLabel(
    name="cam0", width=64, height=48, matrix=((50, 0, 32), (0, 50, 24), (0, 0, 1)), distortion=(0, 0, 0, 0, 0)
)


def sighting(time_ns: int) -> Sighting:
    return Sighting(time_ns, looking_at(10, 10, 1000), np.eye(6))


def around(before_ns: int, after_ns: int | None = None) -> Around:
    after = None if after_ns is None else sighting(after_ns)
    return Around({}, (Expected("box-1", MOMENT, sighting(before_ns), None, after),), steady=True)


class Bench:
    """One held sample of frame ``MOMENT`` that waits for box-1 until the wall clock shows 5000."""

    def __init__(self) -> None:
        self.held = Held()
        self.held.add(
            Job("s1", "ring", 0, CAMERA, (), around(MOMENT - 33 * MS)),
            Wait("cam0", MOMENT, frozenset({"box-1"}), until_ns=5000),
        )

    def due(self, known: Around, newest: int, now: int = 0, *, all_: bool = False) -> list[Job]:
        return list(self.held.due(lambda *_: known, lambda _: newest, now, all_=all_))


def test_it_waits_until_the_object_is_seen_again_and_takes_along_where() -> None:
    bench = Bench()
    assert bench.due(around(MOMENT - 33 * MS), MOMENT + 33 * MS) == []
    assert len(bench.held) == 1
    (job,) = bench.due(around(MOMENT - 33 * MS, MOMENT + 66 * MS), MOMENT + 66 * MS)
    assert job.key == "s1"
    assert job.around.expected[0].after is not None
    assert len(bench.held) == 0


def test_it_goes_on_when_no_later_frame_can_help() -> None:
    assert len(Bench().due(around(MOMENT - 33 * MS), MOMENT - 33 * MS + GAP_NS)) == 1
    assert len(Bench().due(Around({}, steady=True), MOMENT + 33 * MS)) == 1  # forgotten: another stream


def test_it_goes_on_at_its_deadline_or_when_all_must() -> None:
    assert Bench().due(around(MOMENT - 33 * MS), MOMENT, now=4999) == []
    assert len(Bench().due(around(MOMENT - 33 * MS), MOMENT, now=5000)) == 1
    assert len(Bench().due(around(MOMENT - 33 * MS), MOMENT, all_=True)) == 1


def test_what_is_worth_waiting_for() -> None:
    missing = frozenset({"box-1"})
    assert worth_waiting(around(MOMENT - 33 * MS), missing, MOMENT) == missing
    assert worth_waiting(around(MOMENT - 33 * MS), frozenset(), MOMENT) == frozenset()
    assert worth_waiting(around(MOMENT - 600 * MS), missing, MOMENT) == frozenset()  # too long ago to interpolate
    assert worth_waiting(around(MOMENT - 33 * MS, MOMENT + 33 * MS), missing, MOMENT) == frozenset()  # known already
