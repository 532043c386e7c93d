"""The account of frames that are passed over, against a real ring."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from common.frames import FrameWriter, segment_name
from common.labels import CameraLabel
from common.messages import CameraState, FrameRef
from services.detect.cameras import GONE_AFTER_NS, MOST_WAITING, Camera
from tests.support.hygiene import Place

SLOTS = 4
NOW = 1_000_000_000_000
MATRIX = ((500.0, 0.0, 31.5), (0.0, 500.0, 23.5), (0.0, 0.0, 1.0))


def ref(
    frame: int, ring: str = "tagmill-x", *, boot: str = "b1", count: int | None = None, age_s: float = 0
) -> FrameRef:
    return FrameRef(
        camera="cam0",
        boot=boot,
        ring=ring,
        frame=frame,
        count=frame if count is None else count,
        captured_mono_ns=NOW - int(age_s * 1e9),
        captured_wall_ns=0,
        preview=count == 0,
    )


def state(ring: str = "tagmill-x", *, driver: str = "test", paced: bool = False, fps: float = 30.0) -> CameraState:
    label = CameraLabel(name="cam0", width=64, height=48, matrix=MATRIX, distortion=())
    return CameraState(boot="b1", phase="streaming", driver=driver, ring=ring, camera=label, fps=fps, paced=paced)


@pytest.fixture
def camera() -> Iterator[Camera]:
    made = Camera("cam0")
    made.heard(state(), NOW)
    yield made
    made.unmap()


def take(camera: Camera, announced: FrameRef) -> FrameRef | None:
    camera.announced(announced, NOW)
    return camera.next(NOW, SLOTS)


def test_the_newest_frame_is_taken_and_the_others_are_counted(camera: Camera) -> None:
    for frame in (1, 2, 3):
        camera.announced(ref(frame), NOW)
    taken = camera.next(NOW, SLOTS)
    assert taken is not None
    assert taken.frame == 3
    assert not camera.ready
    # Frames before the first that was ever heard of are not ours, but these three were announced to us:
    # which of them were is known only from the counts that follow.
    assert camera.skipped.total == 0
    assert take(camera, ref(9)) is not None
    assert camera.skipped.as_dict() == {"superseded": 5}


def test_frames_of_a_recorded_camera_wait_their_turn(camera: Camera) -> None:
    camera.recorded(True, NOW)
    for frame in range(1, MOST_WAITING + 1):
        camera.announced(ref(frame), NOW)
    assert [taken_of(camera) for _ in range(2)] == [1, 2]
    camera.announced(ref(6), NOW)
    assert [taken_of(camera) for _ in range(4)] == [3, 4, 5, 6]
    assert not camera.ready
    assert camera.skipped.total == 0


def test_a_recorded_camera_whose_frames_pile_up_goes_on_with_the_newest(camera: Camera) -> None:
    camera.recorded(True, NOW)
    assert take(camera, ref(1)) is not None
    for frame in range(2, MOST_WAITING + 3):
        camera.announced(ref(frame), NOW)
    assert taken_of(camera) == MOST_WAITING + 2
    assert not camera.ready
    assert camera.skipped.as_dict() == {"superseded": MOST_WAITING}


def test_after_a_recording_only_the_newest_frame_is_of_interest_again(camera: Camera) -> None:
    camera.recorded(True, NOW)
    camera.recorded(False, NOW)
    for frame in (1, 2):
        camera.announced(ref(frame), NOW)
    assert taken_of(camera) == 2
    camera.recorded(True, NOW)
    later = NOW + 10_000_000_000  # its label process has died meanwhile
    for frame in (3, 4):
        camera.announced(ref(frame), later)
    assert taken_of(camera) == 4


def taken_of(camera: Camera) -> int:
    taken = camera.next(NOW, SLOTS)
    assert taken is not None
    return taken.frame


def test_an_older_announcement_does_not_replace_or_repeat(camera: Camera) -> None:
    camera.announced(ref(5), NOW)
    camera.announced(ref(4), NOW)
    taken = camera.next(NOW, SLOTS)
    assert taken is not None
    assert taken.frame == 5
    camera.announced(ref(5), NOW)
    camera.announced(ref(3), NOW)
    assert not camera.ready
    assert camera.skipped.total == 0


def test_a_new_life_of_the_camera_is_counted_from_its_first_frame(camera: Camera) -> None:
    take(camera, ref(7))
    assert take(camera, ref(4, boot="b2")) is not None
    assert camera.skipped.as_dict() == {"superseded": 3}


def test_stale_news_is_dropped_without_touching_the_ring(camera: Camera) -> None:
    take(camera, ref(1))
    assert take(camera, ref(3, age_s=2.0)) is None
    assert camera.skipped.as_dict() == {"superseded": 1, "stale": 1}


@pytest.mark.parametrize("fps", [5.0, 30.0])
def test_what_is_stale_follows_from_the_rings_history(camera: Camera, fps: float) -> None:
    camera.heard(state(fps=fps), NOW)
    assert (take(camera, ref(1, age_s=0.7)) is None) == (fps == 30.0)


def test_a_frame_of_a_camera_that_waits_for_us_is_never_stale(camera: Camera) -> None:
    camera.heard(state(paced=True), NOW)
    assert take(camera, ref(1, age_s=60)) is not None


@pytest.mark.parametrize(("driver", "paced"), [("files", True), ("files", False), ("synthetic", True)])
def test_there_is_time_to_look_closely_at_a_file_that_waits_for_its_labels(
    camera: Camera, driver: str, paced: bool
) -> None:
    camera.heard(state(driver=driver, paced=paced), NOW)
    assert camera.patient == (driver == "files" and paced)


def test_previews_are_looked_at_and_not_counted(camera: Camera) -> None:
    for frame in (1, 4, 9):
        assert take(camera, ref(frame, count=0)) is not None
    assert take(camera, ref(10, count=1)) is not None
    assert take(camera, ref(12, count=3)) is not None
    assert camera.skipped.as_dict() == {"superseded": 1}


def test_a_camera_is_not_served_before_it_has_said_what_it_is() -> None:
    camera = Camera("cam0")
    camera.announced(ref(1), NOW)
    assert not camera.ready
    camera.heard(state(), NOW)
    assert camera.ready


def test_a_silent_camera_is_gone_and_its_account_stays(camera: Camera) -> None:
    take(camera, ref(1))
    take(camera, ref(3))
    assert not camera.gone(NOW + GONE_AFTER_NS)
    assert camera.gone(NOW + GONE_AFTER_NS + 1)
    camera.forget()
    assert not camera.ready
    camera.heard(state(), NOW)
    take(camera, ref(5))
    assert camera.skipped.as_dict() == {"superseded": 2}


def test_frames_another_instance_looked_at_are_not_ours_to_count(camera: Camera) -> None:
    take(camera, ref(1))
    camera.handed_over()
    assert take(camera, ref(50)) is not None
    assert camera.skipped.total == 0


@pytest.fixture
def ring(place: Place) -> Iterator[FrameWriter]:
    with FrameWriter(segment_name(place.prefix, "cam0", "b1"), 64, 48, False, SLOTS) as writer:
        yield writer


def picture(level: int) -> np.ndarray:
    return np.full((48, 64, 3), level, dtype=np.uint8)


def test_grey_comes_from_the_frame_in_the_ring(camera: Camera, ring: FrameWriter) -> None:
    for level in (50, 100):
        number = ring.write(picture(level))
        grey = camera.grey(ref(number, ring.name))
        assert grey is not None
        assert grey.shape == (48, 64)
        assert (grey == level).all()


def test_an_overwritten_frame_is_lost_and_the_next_one_is_read(camera: Camera, ring: FrameWriter) -> None:
    for level in range(SLOTS + 1):
        newest = ring.write(picture(level))
    assert camera.grey(ref(1, ring.name)) is None
    assert camera.skipped.as_dict() == {"frame_lost": 1}
    assert camera.grey(ref(newest, ring.name)) is not None


def test_a_ring_that_never_was_is_a_lost_frame(camera: Camera) -> None:
    assert camera.grey(ref(1, "tagmill-nobody-cam0-00000000")) is None
    assert camera.grey(ref(2, "../../etc/passwd")) is None
    assert camera.skipped.as_dict() == {"frame_lost": 2}


def test_a_new_ring_is_mapped_when_it_is_announced(camera: Camera, ring: FrameWriter, place: Place) -> None:
    assert camera.grey(ref(ring.write(picture(10)), ring.name)) is not None
    with FrameWriter(segment_name(place.prefix, "cam0", "b2"), 96, 72, False, SLOTS) as second:
        number = second.write(np.full((72, 96, 3), 33, dtype=np.uint8))
        grey = camera.grey(ref(number, second.name, boot="b2"))
        assert grey is not None
        assert grey.shape == (72, 96)
    assert camera.skipped.total == 0
