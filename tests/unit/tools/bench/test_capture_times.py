"""Jitter and losses of a camera, from frames with known times."""

from __future__ import annotations

import pytest

from common.labels import CameraLabel
from common.messages import CameraState, FrameRef
from tools.bench.capture_times import CaptureTimes

MS = 1_000_000
PERIOD_MS = 40
LABEL = CameraLabel(name="cam0", width=32, height=24, matrix=((30, 0, 16), (0, 30, 12), (0, 0, 1)), distortion=())
ALWAYS = (0, 1 << 60)


@pytest.fixture
def times() -> CaptureTimes:
    return CaptureTimes(1000 / PERIOD_MS)


def take(times: CaptureTimes, count: int, at_ms: float) -> None:
    ns = int(at_ms * MS)
    times.announced(
        FrameRef(camera="cam0", boot="b", ring="r", frame=count, count=count, captured_mono_ns=ns, captured_wall_ns=ns)
    )


def run(times: CaptureTimes, frames: int, *, moved_ms: float = 0, first: int = 1, late_ms: float = 0.1) -> None:
    """Frames on a schedule, each a little later than it says, but for one in ten that is later by 5 ms."""
    for count in range(first, first + frames):
        take(times, count, PERIOD_MS * count + moved_ms + late_ms + (5 if count % 10 == 0 else 0))


def state(**lost: int) -> CameraState:
    return CameraState(
        boot="b", phase="streaming", driver="synthetic", ring="r", camera=LABEL, fps=1000 / PERIOD_MS, lost=lost
    )


def test_late_frames_are_no_losses(times: CaptureTimes) -> None:
    run(times, 100)
    captured = times.captured()
    assert (captured.offered, captured.captured, captured.dropped, captured.unheard) == (100, 100, {}, 0)


@pytest.mark.parametrize(("moved_ms", "lost"), [(PERIOD_MS, 1), (1.3 * PERIOD_MS, 1), (7.9 * PERIOD_MS, 8)])
def test_a_schedule_that_has_moved_is_frames_lost(times: CaptureTimes, moved_ms: float, lost: int) -> None:
    run(times, 50)
    run(times, 50, moved_ms=moved_ms, first=51)
    captured = times.captured()
    assert (captured.offered, captured.captured, captured.dropped) == (100 + lost, 100, {"late": lost})


def test_frames_of_which_the_news_was_missed_were_captured(times: CaptureTimes) -> None:
    run(times, 50)
    run(times, 47, first=54)
    captured = times.captured()
    assert (captured.captured, captured.dropped, captured.unheard) == (100, {}, 3)
    assert times.jitter(*ALWAYS).intervals == 49 + 46


def test_what_the_driver_says_it_lost_counts_from_the_first_word_of_it(times: CaptureTimes) -> None:
    times.told(state(missed=2))
    run(times, 50)
    times.told(state(missed=5, stalled=1))
    assert times.captured().dropped == {"missed": 3}


def test_jitter_is_the_deviation_of_the_intervals_in_a_time(times: CaptureTimes) -> None:
    run(times, 101)
    jitter = times.jitter(*ALWAYS)
    assert jitter.intervals == 100
    assert (jitter.p50_ms, jitter.max_ms) == (0, 5)
    calm = times.jitter(11 * PERIOD_MS * MS, 20 * PERIOD_MS * MS)
    assert (calm.intervals, calm.max_ms) == (8, 0)


def test_of_a_camera_that_gave_nothing_there_is_nothing_to_say(times: CaptureTimes) -> None:
    assert times.captured().offered == 0
    assert times.jitter(*ALWAYS).intervals == 0
