"""Asking the drivers what is attached: one that hangs, crashes or babbles costs its own line only."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path

import pytest

from common.errors import CameraError
from services.capture.attached import Found, ask_drivers, main
from services.capture.cameras.base import Attached
from services.capture.usb import plugged


def search(driver: str) -> list[Attached] | None:
    """A driver for each way in which looking can go."""
    match driver:
        case "good":
            return [Attached("good", "A camera", "123", "USB 1-2", ("colour 640x480 30",), "busy")]
        case "none":
            return None
        case "babbles":
            os.write(1, b"INFO: looking\n")
            os.write(2, b"WARNING: well\n")
            return []
        case "refuses":
            raise CameraError("no permission for /dev/x; add yourself to the group video")
        case "bug":
            raise KeyError("serial")
        case "crashes":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "exits":
            os._exit(0)
        case "hangs":
            threading.Event().wait(600)
    raise AssertionError(driver)


def test_each_driver_is_one_line_whatever_it_does(capfd: pytest.CaptureFixture[str]) -> None:
    names = ("good", "none", "babbles", "refuses", "bug", "crashes", "exits")
    found = {item.driver: item for item in ask_drivers(names, deadline_s=60, search=search)}
    assert tuple(found) == names
    assert found["good"].cameras == (Attached("good", "A camera", "123", "USB 1-2", ("colour 640x480 30",), "busy"),)
    assert (found["none"].lists, found["babbles"].lists) == (False, True)
    assert found["babbles"] == Found("babbles")
    problems = {name: found[name].problem or "" for name in names[3:]}
    assert problems["refuses"] == "no permission for /dev/x; add yourself to the group video"
    assert "KeyError" in problems["bug"]
    assert "crashed (SIGSEGV)" in problems["crashes"]
    assert "ended the process" in problems["exits"]
    assert capfd.readouterr().out == "", "what a library prints must not get into the answer"


def test_drivers_that_hang_are_given_up_together_at_the_deadline() -> None:
    found = ask_drivers(("hangs", "hangs", "hangs"), deadline_s=0.3, search=search)
    assert ["has not answered within 0.3 s" in (item.problem or "") for item in found] == [True] * 3


def test_the_built_in_drivers_answer(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["synthetic", "files"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [(item["driver"], item["lists"]) for item in told] == [("synthetic", False), ("files", False)]


def test_a_driver_without_its_library_says_what_to_install() -> None:
    (found,) = ask_drivers(("no-such-driver",), deadline_s=60)
    assert "unknown camera driver 'no-such-driver'" in (found.problem or "")


def usb(folder: Path, name: str, **values: str) -> None:
    device = folder / "sys" / name
    device.mkdir(parents=True)
    for key, value in values.items():
        (device / key).write_text(f"{value}\n")
    node = folder / "dev" / f"{int(values['busnum']):03}" / f"{int(values['devnum']):03}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()


def test_cameras_on_the_usb_are_seen_without_any_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sysfs, nodes = tmp_path / "sys", tmp_path / "dev"
    common = {"busnum": "2", "speed": "5000"}
    usb(
        tmp_path,
        "2-1",
        idVendor="8086",
        idProduct="0b07",
        product="Intel(R) RealSense(TM) Depth Camera 435",
        devnum="4",
        **common,
    )
    usb(tmp_path, "2-2", idVendor="8086", idProduct="0026", product="Bluetooth", devnum="5", **common)
    usb(tmp_path, "1-3", idVendor="045e", idProduct="02d8", product="", devnum="7", busnum="1", speed="480")
    (tmp_path / "sys" / "usb1").mkdir()
    (realsense,) = plugged("realsense", sysfs, nodes)
    assert (realsense.name, realsense.address) == ("Intel(R) RealSense(TM) Depth Camera 435", "USB 2-1")
    assert (realsense.allowed, realsense.hint) == (True, "")
    (kinect,) = plugged("kinect2", sysfs, nodes)
    assert "Kinect v2 runs at USB 2 (480 Mbit/s)" in kinect.hint
    assert plugged("webcam", sysfs, nodes) == ()
    monkeypatch.setattr(os, "access", lambda *_: False)
    (kept,) = plugged("realsense", sysfs, nodes)
    assert "may not open it: sudo cp deploy/udev/70-tagmill-cameras.rules" in kept.hint
    assert (Path(__file__).resolve().parents[4] / "deploy/udev/70-tagmill-cameras.rules").is_file()
