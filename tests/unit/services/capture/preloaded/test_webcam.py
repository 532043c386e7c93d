"""The webcam driver on the preloaded device: OpenCV's real V4L2 backend, everything but the kernel's driver."""

from __future__ import annotations

import errno
import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras import webcam as driver
from services.capture.cameras.base import FrameSkippedError, Grabbed
from services.capture.cameras.webcam import WebcamCamera, attached
from services.capture.cameras.webcam_devices import Places
from tests.support.v4l2 import device as v4l2
from tests.support.v4l2.device import Webcam
from tests.unit.services.capture.conftest import write_calibration

RigOf = Callable[[str], Rig]
Open = Callable[[str], WebcamCamera]
SMALL = "width: 640, height: 480"


@pytest.fixture
def places(tmp_path: Path) -> Places:
    found = Places(tmp_path / "dev", tmp_path / "by-id", tmp_path / "classes")
    for folder in (found.devices, found.names, found.classes):
        folder.mkdir()
    return found


@pytest.fixture
def webcam(places: Places) -> Webcam:
    made = Webcam(places.devices / "video0")
    Webcam(places.devices / "video1", capabilities=v4l2.METADATA)
    for number in (0, 1):
        link(places, f"usb-Test_Cam_HD_A1B2-video-index{number}", f"video{number}")
    return made


def link(places: Places, name: str, node: str) -> None:
    (places.names / name).symlink_to(places.devices / node)


@pytest.fixture
def opened(rig_of: RigOf, places: Places) -> Iterator[Open]:
    made = []

    def make(keys: str) -> WebcamCamera:
        rig = rig_of(f"{{driver: webcam, {keys}}}")
        camera = WebcamCamera("cam0", rig.camera("cam0"), rig, places)
        made.append(camera)
        return camera

    yield make
    for camera in made:
        camera.close()


def frames_of(camera: WebcamCamera, count: int) -> list[Grabbed]:
    return [camera.grab(5.0) for _ in range(count)]


def shades(frames: list[Grabbed]) -> list[int]:
    """Which picture each is; all pixels of a picture are of one grey."""
    found = []
    for frame in frames:
        assert int(frame.bgr.max()) - int(frame.bgr.min()) <= 4
        found.append(round((float(frame.bgr.mean()) - 20) / 25))
    return found


def comes(camera: WebcamCamera, timeout_s: float) -> bool:
    """Whether a picture comes in time."""
    try:
        camera.grab(timeout_s)
    except TimeoutError:
        return False
    return True


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        os.sched_yield()


def told(camera: WebcamCamera) -> str:
    return "\n".join(camera.describe().warnings)


def test_the_mode_is_negotiated_and_read_back(webcam: Webcam, opened: Open) -> None:
    camera = opened(f"{SMALL}, fps: 15")
    about = camera.describe()
    assert (about.camera.width, about.camera.height, about.fps) == (640, 480, 15)
    assert (webcam.state.fourcc, webcam.state.width, webcam.state.fps) == (v4l2.fourcc("MJPG"), 640, 15)
    assert "frames/s" not in told(camera)
    assert "instead of" not in told(camera)


def test_pictures_come_one_after_the_other_with_the_kernels_time(webcam: Webcam, opened: Open) -> None:
    before = time.monotonic_ns()
    camera = opened(f"{SMALL}, fps: 15")
    frames = frames_of(camera, 6)
    after = time.monotonic_ns()
    stamps = [frame.device_ns or 0 for frame in frames]
    assert before < stamps[0] < stamps[-1] < after
    periods = [(later - earlier) * 15 / 1e9 for earlier, later in itertools.pairwise(stamps)]
    assert np.allclose(periods, np.round(periods), atol=0.01)
    assert min(periods) > 0.9
    numbers = shades(frames)
    assert len(set(numbers)) > 1


def test_a_size_of_the_rig_that_the_camera_lacks_is_refused_with_those_it_has(webcam: Webcam, opened: Open) -> None:
    with pytest.raises(CameraError, match=r"gives 1280x720 instead of 1920x1080; it has 1280x720, 640x480, 64x48"):
        opened("width: 1920, height: 1080")
    assert webcam.state.streaming == 0


def test_a_size_nobody_demanded_is_told_only(webcam: Webcam, opened: Open) -> None:
    camera = opened("pixel_format: YUYV")
    assert (camera.describe().camera.width, camera.describe().camera.height) == (640, 480)
    assert "gives 640x480 instead of 1280x720" in told(camera)
    assert camera.grab(5.0).bgr.shape == (480, 640, 3)


def test_a_calibration_of_another_shape_is_refused_and_of_the_same_is_scaled(
    places: Places, opened: Open, tmp_path: Path
) -> None:
    Webcam(places.devices / "video0", [("MJPG", 640, 480, (30,))])
    write_calibration(tmp_path / "wide.yaml", 1280, 720)
    with pytest.raises(CameraError, match="is for 1280x720, its pictures are 640x480"):
        opened("calibration: wide.yaml")
    write_calibration(tmp_path / "same.yaml", 1280, 960)
    about = opened("calibration: same.yaml").describe()
    assert about.camera.matrix[0][0] == pytest.approx(1.1 * 640)
    assert "scaled by 0.500" in "\n".join(about.warnings)


def test_the_calibrations_size_is_asked_for(webcam: Webcam, opened: Open, tmp_path: Path) -> None:
    write_calibration(tmp_path / "cam.yaml", 640, 480)
    about = opened("calibration: cam.yaml").describe()
    assert (about.camera.width, about.camera.height) == (640, 480)
    assert about.camera.intrinsics_from == "calibration"


def test_the_calibration_of_another_camera_is_told(webcam: Webcam, opened: Open, tmp_path: Path) -> None:
    write_calibration(tmp_path / "cam.yaml", 640, 480)
    with (tmp_path / "cam.yaml").open("a") as file:
        file.write("serial: C3D4\n")
    assert "is of the camera C3D4, this one is usb-Test_Cam_HD_A1B2" in told(opened("calibration: cam.yaml"))


def test_another_rate_and_another_format_are_told(places: Places, opened: Open) -> None:
    Webcam(places.devices / "video0", [("YUYV", 640, 480, (10,))])
    camera = opened(f"{SMALL}, fps: 30")
    assert "30 frames/s were asked for, it gives 10" in told(camera)
    assert "gives no MJPG but YUYV" in told(camera)
    assert camera.describe().fps == 10


def test_two_buffers_keep_the_rate_that_one_halves(webcam: Webcam, opened: Open) -> None:
    """A picture that begins while the only buffer is being read is lost, as with a USB camera."""
    shortest = []
    for buffers in (1, 2):
        camera = opened(f"{SMALL}, fps: 15, buffers: {buffers}")
        stamps = [frame.device_ns or 0 for frame in frames_of(camera, 10)]
        shortest.append(min(round((b - a) * 15 / 1e9) for a, b in itertools.pairwise(stamps)))
        camera.close()
    assert shortest == [2, 1]


def test_settings_are_locked_and_their_automatisms_off(webcam: Webcam, opened: Open) -> None:
    keys = "exposure_ms: 8, gain: 12, white_balance_k: 5000, focus: 20, controls: {power_line_frequency: 1}"
    camera = opened(f"{SMALL}, {keys}")
    assert (webcam.value(v4l2.EXPOSURE_AUTO), webcam.value(v4l2.EXPOSURE)) == (1, 80)
    assert (webcam.value(v4l2.FOCUS_AUTO), webcam.value(v4l2.FOCUS)) == (0, 20)
    assert (webcam.value(v4l2.BALANCE_AUTO), webcam.value(v4l2.BALANCE)) == (0, 5000)
    assert (webcam.value(v4l2.GAIN), webcam.value(v4l2.POWER_LINE)) == (12, 1)
    assert "by itself" not in told(camera)


def test_what_is_left_on_is_warned_about(webcam: Webcam, opened: Open) -> None:
    camera = opened(SMALL)
    assert "focuses by itself" in told(camera)
    assert "exposes by itself" in told(camera)


def test_a_value_that_the_camera_rounds_is_told(webcam: Webcam, opened: Open) -> None:
    assert "focus: the camera answers 20, not 23" in told(opened(f"{SMALL}, focus: 23"))


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ("focus: 999", r"cameras\.cam0\.focus: 999 is not possible with this camera; 0 to 250 in steps of 5"),
        ("exposure_ms: 900", r"exposure_ms: 900 is not possible with this camera; 0.3 to 204.7 in steps of 0.1"),
        ("controls: {gian: 1}", "this camera has no such setting; did you mean 'gain'"),
    ],
)
def test_a_setting_that_can_not_be_is_the_rig_files_mistake(
    webcam: Webcam, opened: Open, keys: str, reason: str
) -> None:
    with pytest.raises(ConfigError, match=reason):
        opened(keys)


def test_a_camera_without_a_setting_says_what_it_has(places: Places, opened: Open) -> None:
    Webcam(places.devices / "video0", controls=[v4l2.CONTROLS[6]])
    with pytest.raises(ConfigError, match=r"cameras\.cam0\.focus: this camera can't be set so; it has gain"):
        opened("focus: 3")


def test_a_stall_is_a_timeout_that_lasts_no_longer_than_asked(webcam: Webcam, opened: Open) -> None:
    camera = opened(SMALL)
    camera.grab(5.0)
    webcam.state.stalled = 1
    silent = False
    while not silent:
        began = time.monotonic()
        silent = not comes(camera, 0.2)
    assert 0.15 < time.monotonic() - began < 5, "OpenCV itself would wait for 10 s"
    webcam.state.stalled = 0
    assert camera.grab(5.0).bgr.any()


def test_a_camera_that_gives_nothing_from_the_start_is_lost(
    webcam: Webcam, opened: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "FIRST_PICTURE_S", 1.2)
    webcam.state.stalled = 1
    began = time.monotonic()
    with pytest.raises(CameraError, match="opens but gives no picture"):
        opened(SMALL)
    assert time.monotonic() - began < 7, "OpenCV itself would wait for 10 s"


def test_unplugged_it_is_lost_at_once_and_taken_up_by_its_serial(webcam: Webcam, places: Places, opened: Open) -> None:
    camera = opened(f"{SMALL}, serial: A1B2")
    camera.grab(5.0)
    webcam.unplug()
    with pytest.raises(CameraError, match="is gone: unplugged"):
        frames_of(camera, 100)
    camera.close()
    (places.names / "usb-Test_Cam_HD_A1B2-video-index0").unlink()
    with pytest.raises(CameraError, match="webcam 'A1B2' is not attached"):
        opened(f"{SMALL}, serial: A1B2")
    Webcam(places.devices / "video7")
    link(places, "usb-Test_Cam_HD_A1B2-video-index0", "video7")
    assert opened(f"{SMALL}, serial: A1B2").grab(5.0).bgr.any()


def test_a_slow_consumer_gets_the_newest(webcam: Webcam, opened: Open) -> None:
    camera = opened(f"{SMALL}, fps: 30, buffers: 4")
    camera.grab(5.0)
    begun = webcam.state.pictures
    until(lambda: webcam.state.pictures >= begun + 4)
    webcam.state.stalled = 1
    late = time.monotonic() + 0.1
    until(lambda: time.monotonic() > late)
    assert camera.grab(5.0).bgr.any()
    assert not comes(camera, 0.1), "those that waited before it are passed over"


def test_a_frozen_camera_repeats_its_time(webcam: Webcam, opened: Open) -> None:
    camera = opened(f"{SMALL}, buffers: 1")
    camera.grab(5.0)
    webcam.state.frozen = 1
    frames_of(camera, 2)
    one, two = frames_of(camera, 2)
    assert one.device_ns == two.device_ns
    assert np.array_equal(one.bgr, two.bgr)


def test_a_picture_that_came_damaged_costs_only_itself(webcam: Webcam, opened: Open) -> None:
    camera = opened(f"{SMALL}, buffers: 1")
    camera.grab(5.0)
    webcam.state.cut = 1
    with pytest.raises(FrameSkippedError, match="damaged") as caught:
        frames_of(camera, 20)
    assert caught.value.reason == "damaged"
    assert shades([camera.grab(5.0)])


def test_in_use_by_another_program(webcam: Webcam, opened: Open) -> None:
    first = opened(SMALL)
    with pytest.raises(CameraError, match=r"video0 is in use by another program; close that first"):
        opened(SMALL)
    assert first.grab(5.0).bgr.any(), "the other one is not disturbed"


@pytest.mark.parametrize(
    ("field", "number", "reason"),
    [
        ("open_errno", errno.EACCES, r"no permission for .*video0: add the user to the group video \(sudo usermod"),
        ("open_errno", errno.EBUSY, "is in use by"),
        ("format_errno", errno.EBUSY, "is in use by"),
        ("format_errno", errno.EIO, "can't be used: Input/output error"),
        ("start_errno", errno.ENOSPC, "doesn't stream; if several cameras share a USB port"),
    ],
)
def test_why_it_can_not_be_opened(webcam: Webcam, opened: Open, field: str, number: int, reason: str) -> None:
    setattr(webcam.state, field, number)
    with pytest.raises(CameraError, match=reason):
        opened(SMALL)
    setattr(webcam.state, field, 0)
    assert opened(SMALL).grab(5.0).bgr.any()


@pytest.mark.parametrize("keys", ["index: 0", "serial: A1B2", "serial: usb-Test_Cam_HD_A1B2-video-index0", "gain: 1"])
def test_it_is_found_by_index_by_serial_and_as_the_first(webcam: Webcam, opened: Open, keys: str) -> None:
    assert opened(f"{SMALL}, {keys}").describe().camera.serial == "usb-Test_Cam_HD_A1B2-video-index0"


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ("index: 5", r"there is no camera at .*video5"),
        ("index: 1", r"video1 gives no pictures"),
        ("path: nowhere", r"there is no camera at .*nowhere"),
        ("path: notes.txt", r"notes\.txt is no webcam"),
        ("serial: X", r"webcam 'X' is not attached; .*by-id has usb-Test_Cam_HD_A1B2-video-index0, usb-"),
        ("serial: Test_Cam", r"'Test_Cam' fits several webcams \(usb-Test_Cam_HD_A1B2-video-index0, .*video-index1"),
    ],
)
def test_one_that_is_not_there(
    webcam: Webcam, places: Places, opened: Open, tmp_path: Path, keys: str, reason: str
) -> None:
    (tmp_path / "notes.txt").write_text("no webcam")
    if "Test_Cam" in keys:
        Webcam(places.devices / "video4")
        link(places, "usb-Test_Cam_HD_C3D4-video-index0", "video4")
    with pytest.raises(CameraError, match=reason):
        opened(keys)


def test_no_webcam_at_all(places: Places, opened: Open) -> None:
    with pytest.raises(CameraError, match="no webcam is attached"):
        opened(SMALL)


def test_what_is_attached_is_listed_with_its_modes(webcam: Webcam, places: Places, opened: Open) -> None:
    (found,) = attached(places)
    assert (found.driver, found.name, found.note) == ("webcam", "Test Cam: HD", "")
    assert found.serial == "usb-Test_Cam_HD_A1B2-video-index0"
    assert found.address == str(webcam.path)
    assert found.modes == ("MJPG 1280x720 30", "MJPG 640x480 30/15", "MJPG 64x48 100", "YUYV 640x480 30")
    camera = opened(SMALL)
    assert "in use" in attached(places)[0].note
    assert camera.grab(5.0).bgr.any(), "to list it does not disturb it"


def test_one_without_permission_is_listed_with_the_cure(webcam: Webcam, places: Places) -> None:
    webcam.state.open_errno = errno.EACCES
    (places.classes / "video0").mkdir()
    (places.classes / "video0" / "name").write_text("Test Cam: HD\n")
    (found,) = attached(places)
    assert found.name == "Test Cam: HD"
    assert "sudo usermod -aG video" in found.note
    assert attached(Places(places.devices / "none", places.names, places.classes)) == []
