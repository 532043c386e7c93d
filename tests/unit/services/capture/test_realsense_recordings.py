"""The ``realsense`` driver on recordings: generated ones, and a real camera's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import EndOfStreamError, Grabbed
from services.capture.cameras.realsense import RealSenseCamera
from tests.support.realsense_recordings import Build, Lens, plain_frames, record

RigOf = Callable[[str], Rig]
Open = Callable[[str], RealSenseCamera]
FAST = "pace: consumer"


@pytest.fixture
def open_(rig_of: RigOf) -> Iterator[Open]:
    """``open_("recording: rec.db3")``"""
    opened: list[RealSenseCamera] = []

    def make(keys: str) -> RealSenseCamera:
        rig = rig_of(f"{{driver: realsense, {keys}}}")
        opened.append(RealSenseCamera("cam0", rig.camera("cam0"), rig))
        return opened[-1]

    yield make
    for camera in opened:
        camera.close()


def rest_of(camera: RealSenseCamera) -> list[Grabbed]:
    frames = []
    while True:
        try:
            frames.append(camera.grab(5.0))
        except EndOfStreamError:
            return frames


def values(frames: list[Grabbed]) -> list[int]:
    return [int(frame.bgr[0, 0, 0]) for frame in frames]


def test_every_frame_is_played_once_with_its_depth_and_name(open_: Open, tmp_path: Path) -> None:
    record(tmp_path / "rec.db3", plain_frames(24))
    frames = rest_of(open_(f"recording: rec.db3, {FAST}"))
    assert values(frames) == [10 * number for number in range(1, 25)]
    assert [int(frame.depth[50, 50]) for frame in frames if frame.depth is not None] == [
        1000 * number for number in range(1, 25)
    ]
    assert [frame.source_name for frame in frames] == [f"rec.db3#{index}" for index in range(24)]
    assert np.allclose(np.diff([frame.device_ns or 0 for frame in frames]), 1e9 / 30, rtol=0.01)
    assert sum(frame.missed for frame in frames) == 0


def test_no_frame_is_lost_however_slow_the_reader(open_: Open, tmp_path: Path) -> None:
    """The SDK in real time would have left out most of them."""
    record(tmp_path / "rec.db3", plain_frames(20))
    camera = open_("recording: rec.db3, fps: 12")
    assert values(rest_of(camera)) == [10 * number for number in range(1, 21)]


def test_it_describes_itself_like_the_camera_it_was(open_: Open, tmp_path: Path) -> None:
    build = Build(Lens(320, 240, 260.0), Lens(160, 120, 130.0), serial="4711", fps=15, unit_mm=0.25)
    record(tmp_path / "rec.db3", plain_frames(2, build), build)
    description = open_("recording: rec.db3").describe()
    assert (description.camera.serial, description.camera.intrinsics_from) == ("4711", "factory")
    assert (description.camera.width, description.fps, description.depth_unit_mm) == (320, 15.0, 0.25)
    assert (description.waits_for_start, description.paced, description.stamps) == (True, False, "media")
    assert not open_("recording: rec.db3, begin: at_start").describe().waits_for_start
    assert open_(f"recording: rec.db3, {FAST}").describe().paced
    assert open_("recording: rec.db3, depth: false").describe().depth_unit_mm is None


def test_a_loop_begins_again_and_its_clock_goes_on(open_: Open, tmp_path: Path) -> None:
    record(tmp_path / "rec.db3", plain_frames(3))
    camera = open_(f"recording: rec.db3, loop: true, {FAST}")
    frames = [camera.grab(5.0) for _ in range(9)]
    assert values(frames) == [10, 20, 30] * 3
    assert [frame.source_name for frame in frames] == [f"rec.db3#{index}" for index in range(3)] * 3
    times = [frame.device_ns or 0 for frame in frames]
    assert np.allclose(np.diff(times), 1e9 / 30, rtol=0.01), "a clock that stands still is a frozen camera"


@pytest.mark.parametrize("start", [0, 3, 5, 6])
def test_rewinding_goes_to_any_frame(open_: Open, tmp_path: Path, start: int) -> None:
    record(tmp_path / "rec.db3", plain_frames(5))
    camera = open_(f"recording: rec.db3, {FAST}")
    all_of_it = values(rest_of(camera))
    camera.rewind(start)
    assert values(rest_of(camera)) == all_of_it[start:]


def test_frames_whose_depth_is_missing_are_counted(open_: Open, tmp_path: Path) -> None:
    frames = [
        (colour, None if number in (4, 5) else depth) for number, (colour, depth) in enumerate(plain_frames(8), 1)
    ]
    record(tmp_path / "rec.db3", frames)
    played = rest_of(open_(f"recording: rec.db3, {FAST}"))
    assert values(played) == [10, 20, 30, 60, 70, 80]
    assert [frame.missed for frame in played] == [0, 0, 0, 2, 0, 0]


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda path: None, "the recording .*rec.db3 is gone"),
        (lambda path: path.write_bytes(b"no recording"), "rec.db3 can't be read as a RealSense recording: "),
        (lambda path: path.write_bytes(b""), "rec.db3 can't be read as a RealSense recording: "),
        (
            lambda path: path.write_bytes(record(path, plain_frames(3)).read_bytes()[:20000]),
            "rec.db3 can't be read as a RealSense recording: .*malformed",
        ),
        (lambda path: record(path, []), "rec.db3: .* has no colour mode; it has no colour at all"),
        (
            lambda path: record(path, [(colour, None) for colour, _ in plain_frames(3)]),
            "rec.db3 holds no frame with colour and depth of one moment",
        ),
    ],
    ids=["gone", "other", "empty", "cut", "frameless", "depthless"],
)
def test_a_recording_that_cant_be_played_is_one_sentence(
    open_: Open, tmp_path: Path, make: Callable[[Path], object], told: str
) -> None:
    make(tmp_path / "rec.db3")
    with pytest.raises((CameraError, ConfigError), match=told) as caught:
        open_("recording: rec.db3")
    assert "\n" not in caught.value.message


def test_a_recording_has_the_size_it_has(open_: Open, tmp_path: Path) -> None:
    record(tmp_path / "rec.db3", plain_frames(2))
    with pytest.raises(ConfigError, match="has no colour mode 640xany; it has 160x120 at 30"):
        open_("recording: rec.db3, width: 640")


def test_it_can_be_recorded_in_any_colour_format(open_: Open, tmp_path: Path) -> None:
    for form in ("rgb8", "bgr8"):
        build = replace(Build(), format=form)
        pixels = np.zeros((120, 160, 3), np.uint8)
        pixels[..., form.index("b")] = 200
        record(tmp_path / f"{form}.db3", [(pixels, plain_frames(1)[0][1])], build)
        frame = open_(f"recording: {form}.db3, {FAST}").grab(5.0)
        assert (frame.bgr == [200, 0, 0]).all(), form


def test_a_real_cameras_old_bag(open_: Open, testdata: Callable[[str], Path]) -> None:
    """A D435 at 6 frames/s: one colour picture, two of depth, the first 0.1 s later."""
    path = testdata("recordings/realsense_single_depth_color_640x480.bag")
    camera = open_(f"recording: {path}, {FAST}")
    description = camera.describe()
    assert (description.camera.serial, description.fps, description.depth_unit_mm) == ("728612070259", 6.0, 1.0)
    assert np.allclose(description.camera.matrix, [[613.204, 0, 319.939], [0, 613.419, 239.183], [0, 0, 1]], atol=5e-4)
    frames = rest_of(camera)
    assert len(frames) == 1
    assert frames[0].bgr.shape == (480, 640, 3)
    assert frames[0].bgr.std() > 20, "a picture of something"
    depth = frames[0].depth
    assert depth is not None
    assert depth.shape == (480, 640)
    assert (depth > 0).mean() > 0.3
    assert 200 < np.median(depth[depth > 0]) < 10000
    assert len(rest_of(open_(f"recording: {path}, depth: false, {FAST}"))) == 1
