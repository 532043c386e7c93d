"""Which of the frames that wait label may still take."""

from __future__ import annotations

import pytest

from common import clock
from common.labels import CameraLabel
from common.messages import CameraState, Detections, FrameRef
from services.label.cameras import Camera

FPS, SLOTS = 30.0, 60
LABEL = CameraLabel(name="cam0", width=32, height=24, matrix=((30, 0, 16), (0, 30, 12), (0, 0, 1)), distortion=())


def detections(frame: int) -> Detections:
    ref = FrameRef(
        camera="cam0", boot="b", ring="r", frame=frame, count=frame, captured_mono_ns=frame, captured_wall_ns=frame
    )
    return Detections(ref=ref)


class Clock:
    """The time stands still unless it is told to pass."""

    def __init__(self) -> None:
        self.now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def passes(self, seconds: float) -> None:
        self.now_ns += int(seconds * 1e9)


@pytest.fixture
def clock_(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(clock, "monotonic_ns", made.monotonic_ns)
    return made


def full(*, paced: bool = False) -> Camera:
    """A camera of which a whole ring of frames waits."""
    state = CameraState(boot="b", phase="streaming", driver="synthetic", ring="r", camera=LABEL, fps=FPS, paced=paced)
    camera = Camera(state, SLOTS)
    for frame in range(1, SLOTS + 1):
        camera.arrived(detections(frame))
    return camera


def oldest_alive(camera: Camera) -> int:
    return next(item.ref.frame for item in camera.waiting if camera.alive(item.ref))


def take_turns(camera: Camera, clock_: Clock, *seconds: float) -> None:
    """Label a frame for each of these times, and hear of the camera again."""
    for took_s in seconds:
        with camera.turn():
            clock_.passes(took_s)
    camera.arrived(detections(SLOTS + 1))


def test_a_frame_about_to_be_overwritten_counts_as_gone(clock_: Clock) -> None:
    assert oldest_alive(full()) == 4


def test_what_would_be_overwritten_while_it_is_labelled_is_given_up_before(clock_: Clock) -> None:
    camera = full()
    take_turns(camera, clock_, 0.5, 0.5, 0.6)
    assert oldest_alive(camera) == 5 + 15


def test_one_slow_turn_gives_no_frame_up(clock_: Clock) -> None:
    camera = full()
    take_turns(camera, clock_, 0.004, 0.5, 0.5)
    assert oldest_alive(camera) == 5


def test_a_camera_goes_on_while_another_is_labelled(clock_: Clock) -> None:
    camera = full()
    clock_.passes(0.5)
    assert oldest_alive(camera) == 4 + 15


def test_a_paced_camera_waits(clock_: Clock) -> None:
    camera = full(paced=True)
    clock_.passes(0.5)
    assert oldest_alive(camera) == 4


def test_a_frame_whose_turn_came_can_still_be_asked_for(clock_: Clock) -> None:
    camera = full()
    with camera.turn() as taken:
        assert taken.ref.frame == 1
    assert [item.ref.frame for item in camera.recent] == [1]
    assert camera.waiting[0].ref.frame == 2
