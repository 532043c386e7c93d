"""What every camera driver must do; each built-in driver has a case here, a further one adds its own."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from common.config import Rig, load_rig
from common.errors import CameraError
from common.geometry import CameraModel
from services.capture.cameras.base import Camera, Description, EndOfStreamError, Grabbed, Rewindable
from services.capture.cameras.registry import BUILT_IN, open_camera
from tests.support.realsense_recordings import plain_frames, record
from tests.support.streams import RtspServer, write_h264
from tests.support.v4l2 import device as v4l2
from tests.unit.services.capture.bag_writing import write_rgbd
from tests.unit.services.capture.conftest import write_calibration, write_depths, write_pictures, write_video

FRAMES = 4


@dataclass(frozen=True)
class Case:
    """A driver with its keys. ``prepare`` makes what it needs, ``unplug`` takes that away.

    ``live``: it never ends and gives what is before it, ``hush`` makes it give nothing. ``here``: whether this process
    can drive it; who needs a process of its own runs this module there. ``told_as``: how a lost one is named.
    ``fill`` puts into the keys what only ``prepare`` knows; ``clean`` ends what it started.
    """

    driver: str
    keys: str
    depth: bool = False
    prepare: Callable[[Path], object] = lambda folder: None
    unplug: Callable[[Path], object] | None = None
    live: bool = False
    hush: Callable[[Path], object] | None = None
    here: Callable[[], bool] = lambda: True
    told_as: Callable[[Path], str] = str
    fill: Callable[[Path, str], str] = lambda folder, keys: keys
    clean: Callable[[Path], object] = lambda folder: None


def _photos(folder: Path) -> None:
    write_pictures(folder / "photos", FRAMES)


def _rgbd(folder: Path) -> None:
    _photos(folder)
    write_depths(folder / "far", FRAMES)
    write_calibration(folder / "cam.yaml", 64, 48)


SERVERS: dict[Path, RtspServer] = {}


def _serve(folder: Path) -> None:
    """A network camera that is on and sends, whatever it did before."""
    if folder in SERVERS:
        SERVERS[folder].start()
    else:
        write_h264(folder / "clip.mp4")
        SERVERS[folder] = RtspServer(folder)


def _switch_off(folder: Path) -> None:
    if folder in SERVERS:
        SERVERS.pop(folder).stop()


def _fresh(path: Path) -> Path:
    path.unlink(missing_ok=True)
    return path


CASES = {
    "synthetic": Case("synthetic", f"width: 160, height: 120, fps: 200, frames: {FRAMES}", depth=True),
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
    "webcam": Case(
        "webcam",
        "path: video0, width: 64, height: 48, fps: 25",
        prepare=lambda folder: v4l2.Webcam(folder / "video0", [("MJPG", 64, 48, (25,))]),
        unplug=lambda folder: (folder / "video0").unlink(),
        live=True,
        hush=lambda folder: setattr(v4l2.state_of(folder / "video0"), "stalled", 1),
        here=v4l2.is_preloaded,
    ),
    "stream": Case(
        "stream",
        "url: URL, timeout_s: 3",
        prepare=_serve,
        unplug=lambda folder: SERVERS[folder].stop(),
        live=True,
        hush=lambda folder: SERVERS[folder].hold(),
        here=lambda: not v4l2.is_preloaded(),
        told_as=lambda folder: SERVERS[folder].url("clip.mp4"),
        fill=lambda folder, keys: keys.replace("URL", SERVERS[folder].url("clip.mp4")),
        clean=_switch_off,
    ),
    "realsense-recording": Case(
        "realsense",
        "recording: rec.db3, fps: 200",
        depth=True,
        prepare=lambda folder: record(folder / "rec.db3", plain_frames(FRAMES)),
        unplug=lambda folder: (folder / "rec.db3").unlink(),
    ),
    "realsense-consumer": Case(
        "realsense",
        "recording: rec.db3, pace: consumer, depth: false",
        prepare=lambda folder: record(folder / "rec.db3", plain_frames(FRAMES)),
        unplug=lambda folder: (folder / "rec.db3").unlink(),
    ),
    "files-bag": Case(
        "files",
        "path: recorded.bag, depth_topic: /cam/aligned_depth/image_raw, fps: 200",
        depth=True,
        prepare=lambda folder: write_rgbd("ros1", _fresh(folder / "recorded.bag"), FRAMES),
        unplug=lambda folder: (folder / "recorded.bag").unlink(),
    ),
}
OBJECTS = """\
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 100, border_mm: 15}
"""


@dataclass(frozen=True)
class Played:
    """A camera that was played from its opening to its end, and what it gave (with its description each time)."""

    camera: Camera
    before: Description
    frames: list[tuple[Grabbed, Description]]


@pytest.fixture(scope="module", params=sorted(name for name, case in CASES.items() if case.here()))
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture(scope="module")
def folder(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    made = tmp_path_factory.mktemp(case.driver)
    case.prepare(made)
    yield made
    case.clean(made)


@pytest.fixture(scope="module")
def rig(case: Case, folder: Path) -> Rig:
    path = folder / "rig.yaml"
    path.write_text(f"{OBJECTS}cameras:\n  cam0: {{driver: {case.driver}, {case.fill(folder, case.keys)}}}\n")
    return load_rig(path)


@pytest.fixture(scope="module")
def played(case: Case, rig: Rig) -> Iterator[Played]:
    """Played once for all tests of a case: opening the synthetic camera takes seconds."""
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    before = camera.describe()
    yield Played(camera, before, some_of(camera) if case.live else all_of(camera))
    camera.close()


def all_of(camera: Camera) -> list[tuple[Grabbed, Description]]:
    frames = []
    while True:
        try:
            frames.append(one_of(camera))
        except EndOfStreamError:
            return frames


def some_of(camera: Camera) -> list[tuple[Grabbed, Description]]:
    """As many of a live camera as the others have in all."""
    return [one_of(camera) for _ in range(FRAMES)]


def one_of(camera: Camera) -> tuple[Grabbed, Description]:
    frame = camera.grab(5.0)
    # The arrays are the driver's again at the next grab.
    kept = replace(frame, bgr=frame.bgr.copy(), depth=None if frame.depth is None else frame.depth.copy())
    assert frame.bgr.flags.c_contiguous
    return kept, camera.describe()


def play_again_and_again(camera: Camera) -> None:
    assert isinstance(camera, Rewindable)
    for _ in range(100):
        all_of(camera)
        camera.rewind()


def grab_until_it_is_silent(camera: Camera) -> None:
    """What was on its way still comes."""
    for _ in range(100):
        camera.grab(0.01)


def grab_again_and_again(camera: Camera) -> None:
    for _ in range(100):
        with suppress(TimeoutError):
            camera.grab(0.5)


LIVE = {"kinect2"}
"""They have a module of tests of their own instead."""


def test_every_built_in_driver_has_a_case_or_its_own_tests() -> None:
    assert {case.driver for case in CASES.values()} | LIVE == set(BUILT_IN)
    assert all(Path(__file__).with_name(f"test_{driver}.py").exists() for driver in LIVE)


def test_it_describes_itself_before_the_first_frame(case: Case, played: Played) -> None:
    description = played.before
    assert description.camera.name == "cam0"
    assert description.fps > 0
    assert (description.depth_unit_mm is not None) == case.depth
    assert description.depth_unit_mm is None or description.depth_unit_mm > 0
    model = CameraModel.from_label(description.camera)
    pixel, visible = model.project([[0.0, 0.0, 1000.0]])
    assert visible.all()
    assert model.contains(pixel).all(), "what is straight ahead is in the picture"
    assert all(then == description for _, then in played.frames)


def test_frames_are_as_described(case: Case, played: Played) -> None:
    for frame, description in played.frames:
        about = description.camera
        assert frame.bgr.dtype == np.uint8
        assert frame.bgr.shape == (about.height, about.width, 3)
        assert (frame.depth is not None) == case.depth
        if frame.depth is not None:
            assert frame.depth.dtype == np.uint16
            assert frame.depth.shape == (about.height, about.width)
            assert frame.depth.any()


def test_its_clock_runs(played: Played) -> None:
    times = [frame.device_ns for frame, _ in played.frames]
    known = [stamp for stamp in times if stamp is not None]
    assert len(known) in (0, len(times)), "a device stamps all its frames or none"
    assert known == sorted(set(known))


def test_it_ends_after_the_last_frame_and_stays_at_its_end(case: Case, played: Played) -> None:
    if case.live:
        return
    assert len(played.frames) == FRAMES
    for _ in range(2):
        with pytest.raises(EndOfStreamError):
            played.camera.grab(1.0)


def test_it_rewinds_if_it_waits_for_a_start(played: Played) -> None:
    if not played.before.waits_for_start:
        return
    names = [frame.source_name for frame, _ in played.frames]
    assert isinstance(played.camera, Rewindable)
    for start in (0, FRAMES - 1):
        played.camera.rewind(start)
        assert [frame.source_name for frame, _ in all_of(played.camera)] == names[start:]


def test_opened_again_it_gives_the_same_and_is_closed_twice(case: Case, played: Played, rig: Rig) -> None:
    if case.live:
        played.camera.close()  # a device is one program's at a time
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    again = some_of(camera) if case.live else all_of(camera)
    assert camera.describe() == played.before
    assert case.live or all(
        np.array_equal(one.bgr, two.bgr) for (one, _), (two, _) in zip(played.frames, again, strict=True)
    )
    camera.close()
    camera.close()


def test_it_heeds_the_timeout(case: Case, rig: Rig, folder: Path) -> None:
    slow = rig.camera("cam0") if case.live else rig.camera("cam0").model_copy(update={"fps": 0.001})
    camera = open_camera("cam0", slow, rig)
    camera.grab(5.0)
    if case.hush is not None:
        case.hush(folder)
        with pytest.raises(TimeoutError):
            grab_until_it_is_silent(camera)
        case.prepare(folder)
    elif "pace: consumer" in case.keys:
        camera.grab(0.01)  # as fast as it is asked
    else:
        with pytest.raises(TimeoutError):  # the next frame is due in 1000 s: the test's own limit is the deadline
            camera.grab(0.01)
    camera.close()


def test_unplugged_is_a_camera_error_and_plugged_in_again_it_is_back(case: Case, rig: Rig, folder: Path) -> None:
    if case.unplug is None:
        assert case.driver == "synthetic", "only a camera without hardware or files can't be unplugged"
        return
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    case.unplug(folder)
    with pytest.raises(CameraError) as lost:
        (grab_again_and_again if case.live else play_again_and_again)(camera)
    assert case.told_as(folder) in lost.value.message
    camera.close()
    with pytest.raises(CameraError):
        open_camera("cam0", rig.camera("cam0"), rig)
    case.prepare(folder)
    back = open_camera("cam0", rig.camera("cam0"), rig)
    assert len(some_of(back) if case.live else all_of(back)) == FRAMES
    back.close()
    case.clean(folder)
