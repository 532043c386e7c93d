"""What every camera driver must do; each built-in driver has a case here, a further one adds its own."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from common.config import Rig, load_rig
from common.errors import CameraError
from common.geometry import CameraModel
from services.capture.cameras.base import Camera, EndOfStreamError, Grabbed, Rewindable
from services.capture.cameras.registry import BUILT_IN, open_camera
from tests.unit.services.capture.conftest import write_calibration, write_depths, write_pictures, write_video

FRAMES = 4


@dataclass(frozen=True)
class Case:
    """A driver with its keys. ``prepare`` makes what it needs, ``unplug`` takes that away."""

    driver: str
    keys: str
    depth: bool = False
    prepare: Callable[[Path], object] = lambda folder: None
    unplug: Callable[[Path], object] | None = None


def _photos(folder: Path) -> None:
    write_pictures(folder / "photos", FRAMES)


def _rgbd(folder: Path) -> None:
    _photos(folder)
    write_depths(folder / "far", FRAMES)
    write_calibration(folder / "cam.yaml", 64, 48)


CASES = {
    "synthetic": Case("synthetic", f"width: 160, height: 120, fps: 200, frames: {FRAMES}", depth=True),
    "synthetic-colour": Case("synthetic", f"width: 160, height: 120, fps: 200, frames: {FRAMES}, depth: false"),
    "files-folder": Case(
        "files",
        "path: photos, fps: 200",
        prepare=_photos,
        unplug=lambda folder: shutil.rmtree(folder / "photos"),
    ),
    "files-rgbd": Case(
        "files",
        "path: photos, depth_path: far, depth_unit_mm: 0.5, calibration: cam.yaml, pace: consumer",
        depth=True,
        prepare=_rgbd,
        unplug=lambda folder: shutil.rmtree(folder / "far"),
    ),
    "files-video": Case(
        "files",
        "path: clip.avi, fps: 200",
        prepare=lambda folder: write_video(folder / "clip.avi", FRAMES),
        unplug=lambda folder: (folder / "clip.avi").unlink(),
    ),
}
OBJECTS = """\
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 100, border_mm: 15}
"""


@pytest.fixture(params=sorted(CASES))
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture
def rig(case: Case, tmp_path: Path) -> Rig:
    case.prepare(tmp_path)
    path = tmp_path / "rig.yaml"
    path.write_text(f"{OBJECTS}cameras:\n  cam0: {{driver: {case.driver}, {case.keys}}}\n")
    return load_rig(path)


@pytest.fixture
def camera(rig: Rig) -> Iterator[Camera]:
    made = open_camera("cam0", rig.camera("cam0"), rig)
    yield made
    made.close()


def all_of(camera: Camera) -> list[Grabbed]:
    frames = []
    while True:
        try:
            frames.append(camera.grab(5.0))
        except EndOfStreamError:
            return frames


def play_again_and_again(camera: Camera) -> None:
    assert isinstance(camera, Rewindable)
    for _ in range(100):
        all_of(camera)
        camera.rewind()


def test_every_built_in_driver_has_a_case() -> None:
    assert {case.driver for case in CASES.values()} == set(BUILT_IN)


def test_it_describes_itself_before_the_first_frame(case: Case, camera: Camera) -> None:
    description = camera.describe()
    assert description.camera.name == "cam0"
    assert description.fps > 0
    assert (description.depth_unit_mm is not None) == case.depth
    assert description.depth_unit_mm is None or description.depth_unit_mm > 0
    model = CameraModel.from_label(description.camera)
    pixel, visible = model.project([[0.0, 0.0, 1000.0]])
    assert visible.all()
    assert model.contains(pixel).all(), "what is straight ahead is in the picture"
    assert camera.describe() == description


def test_frames_are_as_described(case: Case, camera: Camera) -> None:
    for frame in all_of(camera):
        about = camera.describe().camera
        assert frame.bgr.dtype == np.uint8
        assert frame.bgr.flags.c_contiguous
        assert frame.bgr.shape == (about.height, about.width, 3)
        assert (frame.depth is not None) == case.depth
        if frame.depth is not None:
            assert frame.depth.dtype == np.uint16
            assert frame.depth.shape == (about.height, about.width)
            assert frame.depth.any()


def test_its_clock_runs(camera: Camera) -> None:
    times = [frame.device_ns for frame in all_of(camera)]
    known = [stamp for stamp in times if stamp is not None]
    assert len(known) in (0, len(times)), "a device stamps all its frames or none"
    assert known == sorted(set(known))


def test_it_ends_after_the_last_frame_and_stays_at_its_end(camera: Camera) -> None:
    assert len(all_of(camera)) == FRAMES
    for _ in range(2):
        with pytest.raises(EndOfStreamError):
            camera.grab(1.0)


def test_it_heeds_the_timeout(case: Case, rig: Rig) -> None:
    slow = rig.camera("cam0").model_copy(update={"fps": 0.05})
    camera = open_camera("cam0", slow, rig)
    camera.grab(5.0)
    began = time.monotonic()
    if "pace: consumer" in case.keys:
        camera.grab(0.01)  # as fast as it is asked
    else:
        with pytest.raises(TimeoutError):
            camera.grab(0.01)
    assert time.monotonic() - began < 15, "far less than the 20 s until its next frame"
    camera.close()


def test_closing_twice_is_closing_once_and_ends_grabbing(camera: Camera) -> None:
    camera.grab(5.0)
    camera.close()
    camera.close()
    with pytest.raises((CameraError, EndOfStreamError)):
        camera.grab(0.1)


def test_it_can_be_opened_again_and_gives_the_same(rig: Rig) -> None:
    passes = []
    for _ in range(2):
        camera = open_camera("cam0", rig.camera("cam0"), rig)
        passes.append([frame.bgr.copy() for frame in all_of(camera)])
        camera.close()
    assert all(np.array_equal(one, two) for one, two in zip(*passes, strict=True))


def test_it_rewinds_if_it_waits_for_a_start(camera: Camera) -> None:
    if not camera.describe().waits_for_start:
        assert all_of(camera)
        return
    assert isinstance(camera, Rewindable)
    names = [frame.source_name for frame in all_of(camera)]
    camera.rewind()
    assert [frame.source_name for frame in all_of(camera)] == names
    camera.rewind(FRAMES - 1)
    assert [frame.source_name for frame in all_of(camera)] == names[-1:]


def test_unplugged_is_a_camera_error_and_plugged_in_again_it_is_back(case: Case, rig: Rig, tmp_path: Path) -> None:
    if case.unplug is None:
        assert case.driver == "synthetic", "only a camera without hardware or files can't be unplugged"
        return
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    case.unplug(tmp_path)
    with pytest.raises(CameraError) as lost:
        play_again_and_again(camera)
    assert str(tmp_path) in lost.value.message
    camera.close()
    with pytest.raises(CameraError):
        open_camera("cam0", rig.camera("cam0"), rig)
    case.prepare(tmp_path)
    back = open_camera("cam0", rig.camera("cam0"), rig)
    assert len(all_of(back)) == FRAMES
    back.close()
