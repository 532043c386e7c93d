"""Calibrations of views whose camera is known, and what is said of sets that allow none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.calibration import Outcome, View, calibrate, distinct
from tests.unit.common.calibration.synthetic import Camera

CAMERA = Camera()


def codes(outcome: Outcome, level: str = "not yet") -> list[str]:
    return [reason.code for reason in outcome.verdict.reasons if reason.level == level]


def looks(tilt: float, places: list[tuple[float, float]], share: float = 0.4) -> list[View]:
    rng = np.random.default_rng(5)
    return [
        CAMERA.look(rng, f"{number}", tilt=tilt, towards=90 * number, place=np.array(place), share=share)
        for number, place in enumerate(places)
    ]


def test_good_views_give_a_good_calibration() -> None:
    outcome = calibrate(CAMERA.good_views(np.random.default_rng(1)), models=("2", "5"))
    assert outcome.verdict.level == "good", outcome.verdict.sentence
    solution = outcome.solution
    assert solution is not None
    assert solution.chosen.lens.name == "5"
    matrix = CAMERA.model.matrix
    true = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])
    assert (np.abs(solution.fit.theta[:4] - true) < 3.5 * solution.uncertainty.sd[:4]).all()


def test_six_frontal_views() -> None:
    views = looks(2.0, [(0.3, 0.3), (0.7, 0.3), (0.3, 0.7), (0.7, 0.7), (0.5, 0.5), (0.5, 0.3)])
    outcome = calibrate(views, models=("2",))
    assert "frontal" in codes(outcome)
    assert "tilt it by 30 to 45 degrees" in outcome.verdict.sentence


def test_one_view_a_hundred_times() -> None:
    view = CAMERA.good_views(np.random.default_rng(1), 1)[0]
    outcome = calibrate([replace(view, name=f"{number}") for number in range(100)])
    assert outcome.solution is None
    assert outcome.verdict.reasons[0].code == "repeated"
    assert "99 of 100 views only repeat another" in outcome.verdict.sentence
    assert len(distinct([view] * 100)[0]) == 1


def test_pictures_of_two_sizes() -> None:
    views = CAMERA.good_views(np.random.default_rng(1), 6)
    outcome = calibrate([*views[:4], *(replace(view, size=(640, 480)) for view in views[4:])])
    assert codes(outcome) == ["sizes"]
    assert "4 of 1280x720, 2 of 640x480" in outcome.verdict.sentence


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_any_view(count: int) -> None:
    outcome = calibrate(CAMERA.good_views(np.random.default_rng(1), 2)[:count])
    assert outcome.verdict.level == "not yet"
    assert outcome.solution is None
