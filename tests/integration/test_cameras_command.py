"""`tagmill cameras list` and `test`, as typed."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import pytest

from tests.support.rigs import SIDES, box
from tests.support.stack import Stack, write_rig
from tests.support.supervised import run_module

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

RIG = (
    """\
objects:
"""
    + box(sides=SIDES[:2])
    + """\
cameras:
  cam0: {driver: synthetic, width: 320, height: 240, fps: 10, prerendered: 4}
  gone: {driver: files, path: nowhere}
"""
)


def cameras(*words: str) -> tuple[int, dict[str, Any]]:
    _, done = run_module("tools", "cameras", *words, "--json")
    assert done.stderr == ""
    return done.returncode, json.loads(done.stdout)


def check(told: dict[str, Any], snapshot: Path) -> None:
    assert told["frames"] >= 5
    assert told["fps"] is not None
    assert told["interval_p50_ms"] <= told["interval_p95_ms"] <= told["interval_longest_ms"]
    assert (told["size"], told["driver"], told["nominal_fps"]) == ([320, 240], "synthetic", 10)
    assert told["depth_valid"] > 0.9
    assert 300 < told["depth_median_mm"] < 10_000
    assert told["exposure"] == "good"
    assert told["looked_at"] > 0
    assert "0" in told["markers"]
    picture = cv2.imread(str(snapshot))
    assert picture is not None
    assert picture.shape == (240, 320, 3)


def test_every_driver_has_its_line_in_the_list() -> None:
    code, told = cameras("list")
    assert code == 0
    drivers = {item["driver"]: item for item in told["drivers"]}
    assert {"synthetic", "files", "webcam", "kinect2"} <= set(drivers)
    for item in drivers.values():
        assert item["problem"] is None or len(item["problem"]) > 20


def test_a_camera_alone_is_opened_by_its_real_process_on_a_bus_of_its_own(tmp_path: Path) -> None:
    rig, snapshot = write_rig(tmp_path, RIG), tmp_path / "shot.png"
    code, told = cameras(
        "test", "cam0", "--rig", str(rig), "--seconds", "1", "--wait", "60", "--snapshot", str(snapshot)
    )
    assert (code, told["ok"], told["held_by"]) == (0, True, None)
    check(told, snapshot)
    assert not list(Path("/dev/shm").glob("tagmill-tagmill-test-*")) or os.environ.get("PYTEST_XDIST_WORKER")


def test_a_camera_that_gives_nothing_is_told_with_its_reason(tmp_path: Path) -> None:
    rig = write_rig(tmp_path, RIG)
    code, told = cameras("test", "gone", "--rig", str(rig), "--wait", "5", "--snapshot", str(tmp_path / "shot.png"))
    assert (code, told["ok"], told["frames"], told["phase"]) == (3, False, 0, "lost")
    assert "does not exist" in told["last_error"]
    assert told["snapshot"] is None


def test_a_camera_that_a_stack_holds_is_looked_at_through_it(tmp_path: Path, stack: Stack) -> None:
    rig, snapshot = write_rig(tmp_path, RIG), tmp_path / "shot.png"
    stack.start_service("control", rig)
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    stack.listen().wait_for_state("capture.cam0")
    code, told = cameras(
        "test", "cam0", "--rig", str(rig), "--seconds", "1", "--wait", "60", "--snapshot", str(snapshot)
    )
    assert code == 0
    assert told["held_by"] == f"capture.cam0 (pid {capture.pid})"
    check(told, snapshot)
    assert capture.running
