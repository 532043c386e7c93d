"""Who is expected, who is missing, who is forgotten."""

from __future__ import annotations

from services.control.roll_call import FORGET_AFTER_NS, RollCall, expected_services
from tests.unit.services.control.known import SECOND, service


def test_a_complete_stack_is_one_capture_a_camera_and_the_workers() -> None:
    assert expected_services(["cam1", "cam0", "cam1"], detect=2, label=1) == (
        *("capture.cam0", "capture.cam1", "detect.0", "detect.1", "label.0"),
        *("store", "control"),
    )


def test_a_service_is_missing_before_its_first_word_and_after_three_silent_seconds() -> None:
    call = RollCall()
    assert call.missing(["store"], 0) == ("store",)
    call.hear(service("store"), 0)
    assert call.missing(["store"], 3 * SECOND) == ()
    assert call.missing(["store"], 3 * SECOND + 1) == ("store",)
    call.hear(service("store"), 4 * SECOND)
    assert call.alive("store", 5 * SECOND)


def test_a_stopped_service_is_missing_at_once() -> None:
    call = RollCall()
    call.hear(service("store", phase="stopped"), 0)
    assert call.missing(["store", "control"], 1) == ("control", "store")


def test_only_unexpected_ones_are_forgotten() -> None:
    call = RollCall()
    call.hear(service("store"), 0)
    call.hear(service("capture.cam9"), 0)
    call.hear(service("capture.cam8", phase="stopped"), 0)
    call.tidy(["store"], SECOND)
    assert list(call.heard) == ["capture.cam9", "store"]
    call.tidy(["store"], FORGET_AFTER_NS + 1)
    assert list(call.heard) == ["store"]


def test_heartbeats_and_restarts_are_counted() -> None:
    call = RollCall()
    for boot in ("b1", "b1", "b2"):
        call.hear(service("label.0", boot), 0)
    assert call.beats("label.0") == 3
    assert call.beats("label.1") == 0
    assert call.heard["label.0"].restarts == 1
