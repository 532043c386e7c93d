"""Settings of a RealSense: set through the SDK on a software camera that has the options of a D435."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyrealsense2 as rs
import pytest

from common.config import Rig, load_rig
from common.errors import CameraError, ConfigError
from services.capture.cameras import realsense
from services.capture.cameras.realsense import RealSenseCamera, attached
from services.capture.cameras.realsense_sdk import camera_error
from tests.support.realsense_recordings import Build, Plugged, SoftCamera
from tests.unit.services.capture.test_registry import ROOT

RigOf = Callable[[str], Rig]
COLOUR = {
    "enable_auto_exposure": (0, 1, 1, 1),
    "exposure": (1, 10000, 1, 166),
    "gain": (0, 128, 1, 64),
    "enable_auto_white_balance": (0, 1, 1, 1),
    "white_balance": (2800, 6500, 10, 4600),
    "global_time_enabled": (0, 1, 1, 0),
}
DEPTH = {
    "enable_auto_exposure": (0, 1, 1, 1),
    "exposure": (1, 200000, 1, 8500),
    "gain": (16, 248, 1, 16),
    "emitter_enabled": (0, 2, 1, 1),
    "laser_power": (0, 360, 30, 150),
    "visual_preset": (0, 6, 1, 0),
    "inter_cam_sync_mode": (0, 260, 1, 0),
}


class Options:
    """What the sensors of a software camera are set to."""

    def __init__(self, sensor: Any, ranges: dict[str, tuple[float, ...]]) -> None:
        self._sensor = sensor
        for name, (least, most, step, default) in ranges.items():
            allowed = rs.option_range()
            allowed.min, allowed.max, allowed.step, allowed.default = least, most, step, default
            sensor.add_option(getattr(rs.option, name), allowed, True)

    def __getitem__(self, name: str) -> float:
        return float(self._sensor.get_option(getattr(rs.option, name)))

    def __setitem__(self, name: str, value: float) -> None:
        self._sensor.set_option(getattr(rs.option, name), value)


class Bench:
    """A software D435 and the driver opened on it."""

    def __init__(self, rig_of: RigOf) -> None:
        self._rig_of = rig_of
        self._plugged = Plugged()
        self.soft: SoftCamera = self._plugged.plug()
        self.colour = Options(self.soft.colour, COLOUR)
        self.depth = Options(self.soft.depth, DEPTH)

    def apply(self, keys: str) -> None:
        rig = self._rig_of(f"{{driver: realsense, {keys}}}")
        RealSenseCamera("cam0", rig.camera("cam0"), rig, self._plugged.context).close()


@pytest.fixture
def bench(rig_of: RigOf) -> Bench:
    return Bench(rig_of)


def test_what_the_rig_gives_is_set(bench: Bench) -> None:
    bench.apply(
        "exposure: 120, gain: 32, white_balance: 5000, depth_exposure: 4000, depth_gain: 20, laser_power: 240, "
        "emitter: false, preset: High accuracy, sync: slave"
    )
    assert [bench.colour[key] for key in ("enable_auto_exposure", "exposure", "gain")] == [0, 120, 32]
    assert [bench.colour[key] for key in ("enable_auto_white_balance", "white_balance")] == [0, 5000]
    assert bench.colour["global_time_enabled"] == 1
    assert [bench.depth[key] for key in ("enable_auto_exposure", "exposure", "gain")] == [0, 4000, 20]
    assert [bench.depth[key] for key in ("laser_power", "emitter_enabled")] == [240, 0]
    assert bench.depth["visual_preset"] == int(rs.rs400_visual_preset.high_accuracy)
    assert bench.depth["inter_cam_sync_mode"] == 2


def test_what_it_doesnt_give_is_automatic_whatever_the_viewer_left(bench: Bench) -> None:
    for options in (bench.colour, bench.depth):
        options["enable_auto_exposure"] = 0
    bench.depth["inter_cam_sync_mode"] = 1
    bench.colour["enable_auto_white_balance"] = 0
    bench.apply("depth: true")
    assert bench.colour["enable_auto_exposure"] == bench.depth["enable_auto_exposure"] == 1
    assert bench.colour["enable_auto_white_balance"] == 1
    assert bench.depth["inter_cam_sync_mode"] == 0
    assert bench.depth["laser_power"] == 150, "the camera's own"


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("exposure: 20000", "exposure: 20000 is not allowed; this camera's RGB Camera takes 1 to 10000 in steps of 1"),
        ("laser_power: 400", "laser_power: 400 is not allowed; this camera's Stereo Module takes 0 to 360 in steps"),
        ("preset: sharp", "preset: this camera has no 'sharp'; it has custom, default, hand, high_accuracy"),
    ],
)
def test_what_the_camera_doesnt_allow_is_a_sentence(bench: Bench, keys: str, told: str) -> None:
    with pytest.raises(ConfigError, match=f"^camera cam0: {told}"):
        bench.apply(keys)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("white_balance: 5000", "white_balance: this camera's RGB Camera can't set white_balance; leave it out"),
        ("sync: master", "sync: this camera's Stereo Module can't set inter_cam_sync_mode"),
        ("preset: hand", "preset: this camera has no visual presets"),
    ],
)
def test_what_the_camera_doesnt_have_is_a_sentence(rig_of: RigOf, keys: str, told: str) -> None:
    plugged = Plugged()
    plugged.plug()
    rig = rig_of(f"{{driver: realsense, {keys}}}")
    with pytest.raises(ConfigError, match=told):
        RealSenseCamera("cam0", rig.camera("cam0"), rig, plugged.context)


def test_a_preset_file_that_cant_be_used_is_a_sentence(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"preset_file: .*mine.json can't be read as JSON"):
        bench.apply("preset_file: mine.json")
    (tmp_path / "mine.json").write_text("{")
    with pytest.raises(ConfigError, match=r"preset_file: .*mine.json can't be read as JSON"):
        bench.apply("preset_file: mine.json")
    (tmp_path / "mine.json").write_text(json.dumps({"param-depthunits": 1000}))
    with pytest.raises(ConfigError, match=r"preset_file: the Software RealSense .* takes no such file"):
        bench.apply("preset_file: mine.json")


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("seriel: x", r"cam0.seriel: unknown key; did you mean 'serial'\?"),
        ("serial: 12345", "serial: must be text, not 12345; write it in quotes"),
        ("gain: 3", "gain: needs `exposure` too"),
        ("depth_gain: 30", "depth_gain: needs `depth_exposure` too"),
        ("sync: mastr", "sync: 'mastr' is not allowed; did you mean 'master'"),
        ("loop: true", "loop: belongs to a `recording`"),
        ("recording: rec.db3, exposure: 3", "exposure: belongs to an attached camera"),
        ("recording: rec.db3", "recording: there is nothing at .*rec.db3"),
        ("depth: false, laser_power: 30", "laser_power: is of the depth sensor"),
        ("depth_size: [640]", "depth_size"),
        ("exposure: -1", "exposure: -1 is not allowed; must be at least 0"),
    ],
)
def test_the_check_of_a_rig_knows_the_keys(tmp_path: Path, keys: str, told: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(f"cameras:\n  cam0: {{driver: realsense, {keys}}}\n")
    with pytest.raises(ConfigError, match=told) as caught:
        load_rig(path, inputs=True)
    assert len(caught.value.problems) == 1


def test_attached_tells_each_camera_with_its_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    plugged = Plugged()
    plugged.plug(Build(usb="2.1"))
    monkeypatch.setattr(realsense.rs, "context", lambda: plugged.context)
    found = attached()
    assert [(one.driver, one.name, one.serial) for one in found] == [
        ("realsense", "Software RealSense (firmware 5.16.0.1)", "012345678901")
    ]
    assert found[0].modes == ("colour 160x120 30", "depth 160x120 30")
    assert "USB 3 port" in found[0].note


def test_nothing_attached_is_an_empty_list() -> None:
    assert attached() == []


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "failed to open usb interface: 0, error: RS2_USB_STATUS_ACCESS",
            "no permission .*70-tagmill-cameras.rules to /etc/udev",
        ),
        ("xioctl(VIDIOC_S_FMT) failed, errno=16 Last Error: Device or resource busy", "another program uses it"),
        ("something\nelse", "^opening: something else$"),
    ],
)
def test_the_sdks_texts_become_sentences(text: str, told: str) -> None:
    error = camera_error("opening", RuntimeError(text))
    assert isinstance(error, CameraError)
    with pytest.raises(CameraError, match=told):
        raise error


@pytest.mark.parametrize(
    ("module", "told"),
    [
        ("raise ImportError(\"No module named 'pyrealsense2'\")", "pip install 'tagmill[realsense]'"),
        (
            "raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')",
            "apt install libusb-1.0-0",
        ),
    ],
)
def test_a_missing_sdk_or_library_is_told_with_the_cure(tmp_path: Path, module: str, told: str) -> None:
    (tmp_path / "pyrealsense2.py").write_text(module)
    script = (
        "from common.errors import ConfigError\n"
        "from services.capture.cameras import registry\n"
        "for load in (registry.load_driver, registry.load_attached):\n"
        "    try:\n"
        "        load('realsense')\n"
        "    except ConfigError as error:\n"
        "        print(error.message)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    assert all(told in line for line in lines), lines
