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


def test_ten_views_of_one_corner_of_the_picture() -> None:
    rng = np.random.default_rng(4)
    views = [
        CAMERA.look(
            rng,
            f"{n}",
            tilt=30,
            towards=36.0 * n,
            place=np.array([0.14 + 0.02 * (n % 4), 0.15 + 0.03 * (n % 3)]),
            share=0.2,
        )
        for n in range(10)
    ]
    outcome = calibrate(views, models=("2",))
    assert "badly_spread" in codes(outcome)
    assert "of the picture (upper left): show the board also at its" in outcome.verdict.sentence


def test_a_blurred_set() -> None:
    views = [replace(view, edge_px=9.0) for view in CAMERA.good_views(np.random.default_rng(1), 12)]
    outcome = calibrate(views, models=("5",))
    assert codes(outcome) == ["blurred"]
    assert "12 of 12 views are blurred (edges 9 px wide)" in outcome.verdict.sentence


def test_a_view_that_was_moved_is_named_and_left_out() -> None:
    views = CAMERA.good_views(np.random.default_rng(1), 14)
    views[5].corners[:] += np.random.default_rng(2).normal(0, 1.0, views[5].corners.shape)
    outcome = calibrate(views, models=("5",))
    assert [(item.name, item.code) for item in outcome.dropped] == [("05", "outlier")]
    assert outcome.verdict.level == "good"


def test_single_corners_that_are_misplaced_are_left_out() -> None:
    views = CAMERA.good_views(np.random.default_rng(1), 14)
    views[3].corners[7] += 4.0
    outcome = calibrate(views, models=("5",))
    assert outcome.dropped == ()
    assert outcome.solution is not None
    assert outcome.solution.dropped_corners == {"03": 1}
