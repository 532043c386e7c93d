"""`mode: auto`: a view is worth a sample if it is new, sharp, and fits; what it thinks is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from common.geometry import Pose
from common.ledgers import AutoLimits
from services.label.auto import MEASURE_EVERY_NS, Auto


def seen(turn_deg: float = 0.0, distance: float = 1000.0, *, fit: float = 0.1, ambiguous: bool = False) -> Any:
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    quality = SimpleNamespace(reprojection_error_px=fit, ambiguous=ambiguous)
    return SimpleNamespace(name="box", pose=Pose(turn, np.array([0.0, 0.0, distance])).label(), quality=quality)


class Meter:
    """Gives one sharpness, and counts how often it is asked."""

    def __init__(self, value: float | None) -> None:
        self.value, self.asked = value, 0

    def __call__(self) -> dict[str, float]:
        self.asked += 1
        return {} if self.value is None else {"box": self.value}


def test_a_view_is_new_by_angle_or_by_distance() -> None:
    auto = Auto(AutoLimits(new_deg=12, new_mm=80))
    sharp = Meter(50)
    assert auto.judge(1, [seen()], sharp, 0) is None
    auto.take("s1", [seen()])
    assert auto.judge(2, [seen(11)], sharp, 0) == "not_new"
    assert auto.judge(3, [seen(13)], sharp, 0) is None
    assert auto.judge(4, [seen(0, 1079)], sharp, 0) == "not_new"
    assert auto.judge(5, [seen(0, 1081)], sharp, 0) is None
    auto.forget("s1")
    assert auto.judge(6, [seen()], sharp, 0) is None


def test_the_limits_are_those_of_the_recording() -> None:
    auto = Auto(AutoLimits(new_deg=2, new_mm=5, fit_px=0.5, sharpness=30))
    auto.take("s1", [seen()])
    assert auto.judge(1, [seen(3)], Meter(31), 0) is None
    assert auto.judge(2, [seen(3)], Meter(29), 0) == "blurred"
    assert auto.judge(3, [seen(3, fit=0.6)], Meter(31), 0) == "bad_fit"
    assert auto.judge(4, [seen(3, ambiguous=True)], Meter(31), 0) == "bad_fit"


def test_what_it_thinks_is_told_beside_the_limits() -> None:
    auto = Auto(AutoLimits())
    auto.take("s1", [seen()])
    auto.judge(7, [seen(5, 1020)], Meter(44), 0)
    assert auto.now is not None
    (item,) = auto.now.objects
    assert (auto.now.frame, auto.now.reason, item.object, item.sharpness) == (7, "not_new", "box", 44)
    assert item.new_deg == pytest.approx(5)
    assert item.new_mm == pytest.approx(20)
    auto.judge(8, [seen(90, 3000)], Meter(44), 0)
    assert auto.now.objects[0].new_deg is None, "nothing was taken from about there"
    auto.nothing(9, "incomplete")
    assert (auto.now.frame, auto.now.reason, auto.now.objects) == (9, "incomplete", ())


def test_pixels_are_looked_at_for_few_frames() -> None:
    auto, meter = Auto(AutoLimits()), Meter(50)
    auto.take("s1", [seen()])
    for frame in range(30):
        auto.judge(frame, [seen()], meter, frame * 10_000_000)
    assert meter.asked == 1 + 290_000_000 // MEASURE_EVERY_NS
    auto.judge(31, [seen(40)], meter, 300_000_000)
    assert meter.asked == 3, "one that is worth a sample otherwise is always measured"
    never = Meter(1)
    assert Auto(AutoLimits(sharpness=0)).judge(1, [seen()], never, 0) is None
    assert never.asked == 0


def test_a_frame_that_is_gone_is_not_called_blurred() -> None:
    assert Auto(AutoLimits()).judge(1, [seen()], Meter(None), 0) is None
