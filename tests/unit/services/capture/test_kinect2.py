"""The ``kinect2`` driver: with the real library where it is, else against recorded arrays played with its face."""

from __future__ import annotations

import importlib
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from common import log
from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras import registry
from services.capture.last_life import LastLife
from tests.unit.services.capture.conftest import write_calibration

ROOT = Path(__file__).resolve().parents[4]
PLAYER = ROOT / "tests" / "support" / "kinect2"
DRIVER = "services.capture.cameras.kinect2"
RigOf = Callable[[str], Rig]


def frame(number: int, late_ticks: int = 40) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Colour whose left (mirrored: right) half is bright, with depth; depth ticks as given earlier."""
    colour = np.full((1080, 1920, 4), 10 * (number % 20), np.uint8)
    colour[:, :960] = 250
    depth = np.full((1082, 1920), 1000.0 + number, np.float32)
    depth[:, :200] = np.inf
    ticks = 5000 + 266 * number
    return colour, depth, ticks, ticks - late_ticks


@pytest.fixture
def player(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The player in the library's place, and the driver imported anew on it."""
    monkeypatch.syspath_prepend(str(PLAYER))
    for name in ("pylibfreenect2", DRIVER):
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module("pylibfreenect2")
    for name in ("pylibfreenect2", DRIVER):
        sys.modules.pop(name, None)


def driver() -> ModuleType:
    return importlib.import_module(DRIVER)


def opened(player: Any, rig: Rig, frames: int = 0, **more: Any) -> Any:
    """An open camera; the first frame is used up by the opening."""
    player.SCRIPT.frames = [frame(number, **more) for number in range(frames + 1)]
    return driver().Kinect2Camera("cam0", rig.camera("cam0"), rig)


def test_frames_are_the_right_way_round_and_released(player: Any, rig_of: RigOf) -> None:
    camera = opened(player, rig_of("{driver: kinect2}"), frames=2)
    about = camera.describe()
    assert (about.camera.width, about.camera.height, about.camera.serial) == (1920, 1080, "0815")
    assert (about.camera.intrinsics_from, about.depth_unit_mm, about.fps) == ("factory", 1.0, 30.0)
    one, two = camera.grab(1.0), camera.grab(1.0)
    assert [grabbed.bgr[0, 0].tolist() for grabbed in (one, two)] == [[10] * 3, [20] * 3]
    assert one.bgr[0, -1].tolist() == [250] * 3
    assert (one.depth[0, 0], one.depth[0, -1], two.depth[0, 0]) == (1001, 0, 1002)
    assert two.device_ns - one.device_ns == 266 * 125_000
    assert player.SCRIPT.held == 0
    with pytest.raises(TimeoutError, match="attached but gave no frame in time"):
        camera.grab(0.01)
    camera.close()
    camera.close()
    assert player.SCRIPT.closed == 1
    with pytest.raises(CameraError, match="closed"):
        camera.grab(0.01)


def test_the_serial_is_matched_as_bytes_before_anything_is_opened(player: Any, rig_of: RigOf) -> None:
    player.SCRIPT.attached = [b"0815", b"4711"]
    opened(player, rig_of("{driver: kinect2, serial: '4711'}")).close()
    assert player.SCRIPT.opened == [(b"4711", "CpuPacketPipeline")]
    with pytest.raises(CameraError, match="no Kinect v2 of serial 4712 is attached; there is 0815, 4711"):
        opened(player, rig_of("{driver: kinect2, serial: '4712'}"))
    player.SCRIPT.attached = []
    with pytest.raises(CameraError, match="no Kinect v2 is attached"):
        opened(player, rig_of("{driver: kinect2}"))
    assert len(player.SCRIPT.opened) == 1


def test_unplugged_is_told_apart_from_late(player: Any, rig_of: RigOf) -> None:
    camera = opened(player, rig_of("{driver: kinect2}"))
    with pytest.raises(TimeoutError):
        camera.grab(0.01)
    player.SCRIPT.attached = [b"4711"]
    with pytest.raises(CameraError, match="0815 is unplugged"):
        camera.grab(0.01)


def test_a_start_without_a_first_frame_has_failed(player: Any, rig_of: RigOf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver(), "FIRST_FRAME_S", 0.05)
    rig = rig_of("{driver: kinect2}")
    with pytest.raises(CameraError, match=r"0815 was opened but gave no frame within 0\.05 s"):
        driver().Kinect2Camera("cam0", rig.camera("cam0"), rig)
    assert player.SCRIPT.closed == 1


@pytest.mark.parametrize(("late_ticks", "told"), [(800, "colour is taken 100 ms after the depth"), (40, None)])
def test_the_time_between_colour_and_depth_is_told_once(
    player: Any, rig_of: RigOf, late_ticks: int, told: str | None
) -> None:
    camera = opened(player, rig_of("{driver: kinect2, width: 640}"), frames=31, late_ticks=late_ticks)
    for _ in range(29):
        camera.grab(1.0)
        assert camera.describe().warnings == ()
    camera.grab(1.0)
    after = camera.describe()
    assert [told in warning for warning in after.warnings] == [True] if told else after.warnings == ()
    camera.grab(1.0)
    assert camera.describe() is after


def test_a_smaller_picture_has_intrinsics_that_fit(player: Any, rig_of: RigOf) -> None:
    camera = opened(player, rig_of("{driver: kinect2, width: 960}"), frames=1)
    grabbed, about = camera.grab(1.0), camera.describe().camera
    assert grabbed.bgr.shape == (540, 960, 3)
    assert grabbed.depth.shape == (540, 960)
    assert about.matrix[0][0] == pytest.approx(1081.37 / 2)
    assert about.matrix[0][2] == pytest.approx((959.5 + 0.5) / 2 - 0.5)


def test_a_calibration_wins_over_the_factory(player: Any, rig_of: RigOf, tmp_path: Path) -> None:
    write_calibration(tmp_path / "cam.yaml", 1920, 1080)
    camera = opened(player, rig_of("{driver: kinect2, width: 1920, calibration: cam.yaml}"))
    about = camera.describe().camera
    assert (about.intrinsics_from, about.serial) == ("calibration", "0815")
    assert about.distortion[0] == 0.1


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("width: 1000", "not 1000x562"),
        ("width: 640, height: 480", "not 640x480"),
        ("width: 3840", "not 3840x2160"),
        ("pipeline: opengl", "built without opengl"),
    ],
)
def test_what_it_can_not_give_is_a_config_error(player: Any, rig_of: RigOf, keys: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        opened(player, rig_of(f"{{driver: kinect2, {keys}}}"))
    assert player.SCRIPT.opened == []


def test_check_knows_its_keys(rig_of: RigOf) -> None:
    with pytest.raises(ConfigError, match=r"cameras\.cam0\.pipeline"):
        rig_of("{driver: kinect2, pipeline: cuda}")
    with pytest.raises(ConfigError, match="did you mean 'serial'"):
        rig_of("{driver: kinect2, serail: x}")


def test_attached_names_what_is_there(player: Any) -> None:
    player.SCRIPT.attached = [b"0815", b"4711"]
    search = registry.load_attached("kinect2")
    assert search is not None
    assert [(found.driver, found.serial) for found in search()] == [("kinect2", "0815"), ("kinect2", "4711")]


def test_an_open_that_kills_the_process_is_told_by_the_next(tmp_path: Path) -> None:
    note = tmp_path / "capture.cam0.life"
    rig = tmp_path / "rig.yaml"
    rig.write_text("cameras:\n  cam0: {driver: kinect2}\n")
    script = (
        "import sys; from pathlib import Path; from common import log; from common.config import load_rig\n"
        f"sys.path.insert(0, {str(PLAYER)!r}); import pylibfreenect2; pylibfreenect2.SCRIPT.opens = False\n"
        "from services.capture.cameras.registry import open_camera\n"
        "from services.capture.last_life import LastLife\n"
        f"rig = load_rig(Path({str(rig)!r})); life = LastLife(Path({str(note)!r}), 'cam0', 'kinect2', log.get())\n"
        "life.guard(lambda: open_camera('cam0', rig.camera('cam0'), rig))()\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], cwd=ROOT, timeout=60, check=False)
    assert ended.returncode == -signal.SIGSEGV
    died = LastLife(note, "cam0", "kinect2", log.get()).died
    assert died is not None
    assert (died.signal, died.opening) == ("SIGSEGV", True)
    assert "died by SIGSEGV while opening the camera (kinect2)" in died.sentence("cam0", "kinect2")


def test_the_missing_library_is_a_config_error_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pylibfreenect2", DRIVER):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "pylibfreenect2", None)
    with pytest.raises(ConfigError, match=r"driver 'kinect2' can't be used: .*docs/how-to/kinect-v2\.md"):
        registry.load_driver("kinect2")


def test_with_the_real_library_a_camera_that_is_not_there_is_told_at_once(rig_of: RigOf) -> None:
    pytest.importorskip(
        "pylibfreenect2", reason="libfreenect2 is in no package registry, so pylibfreenect2 can't be built"
    )
    rig = rig_of("{driver: kinect2, serial: 'not-there'}")
    with pytest.raises(CameraError, match="no Kinect v2"):
        driver().Kinect2Camera("cam0", rig.camera("cam0"), rig)
