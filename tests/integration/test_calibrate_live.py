"""`tagmill calibrate --camera` as typed: a synthetic camera shows a board, the command takes views until it is good."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import pytest

from common.boards import Board, write_board
from common.config import read_calibration
from common.messages import CameraState
from common.topics import CAMERA
from tests.support.stack import ROOT, Stack, wait_for, write_rig
from tests.support.supervised import run_module

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

BOARD = Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250")
FOCAL = 460.0
RIG = """\
cameras:
  cam0: {{driver: synthetic, width: 640, height: 480, fps: 15, board: board.yaml, speed: 2.5, focal_px: 460{more}}}
  still: {{driver: files, path: photos}}
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    write_board(tmp_path / "board.yaml", BOARD)
    return write_rig(tmp_path, RIG.format(more=""))


def calibrate(rig: Path, *words: str) -> tuple[int, dict[str, Any]]:
    _, done = run_module(
        "tools", "calibrate", "--rig", str(rig), "--board", str(rig.parent / "board.yaml"), *words, "--json"
    )
    assert done.stderr == ""
    return done.returncode, json.loads(done.stdout)


@pytest.mark.long
def test_it_reaches_good_by_itself_through_the_stack_and_capture_then_uses_it(rig: Path, stack: Stack) -> None:
    stack.start_service("control", rig)
    capture = stack.start_service("capture", rig, "--camera", "cam0")
    stack.listen().wait_for_state("capture.cam0")
    code, told = calibrate(rig, "--camera", "cam0", "--model", "5")
    assert (code, told["verdict"]) == (0, "good")
    assert capture.running
    path = rig.parent / "calibration" / "cam0-640x480.yaml"
    assert told["file"] == str(path)
    label = read_calibration(path, "cam0")
    assert label.serial == told["serial"] == "synthetic-1"
    sd = told["parameters"]["fx"]["sd"]
    assert abs(label.matrix[0][0] - FOCAL) < max(4 * sd, 1.0)
    pictures = sorted(Path(told["pictures"]).iterdir())
    assert [picture.name for picture in pictures] == sorted(view["name"] for view in told["views"])
    assert len(pictures) >= 10
    assert any("calibration: calibration/cam0-640x480.yaml" in note for note in told["notes"])

    rig.write_text(RIG.format(more=", calibration: calibration/cam0-640x480.yaml"))
    assert capture.stop() == 0
    listener = stack.listen(CAMERA)
    stack.start_service("capture", rig, "--camera", "cam0")
    state = listener.wait_for(
        lambda received: isinstance(received.message, CameraState) and received.message.phase == "streaming",
        why="the restarted camera",
    ).message
    assert isinstance(state, CameraState)
    assert state.camera.intrinsics_from == "calibration"
    assert state.camera.matrix == label.matrix


@pytest.mark.long
def test_ctrl_c_keeps_the_views_of_a_camera_that_runs_alone(rig: Path, stack: Stack) -> None:
    words = ["calibrate", "--rig", str(rig), "--camera", "cam0", "--board", str(rig.parent / "board.yaml"), "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "tools", *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    folder = rig.parent / "calibration" / "cam0-640x480-views"
    wait_for(lambda: len(list(folder.glob("*.png"))) >= 2, 90.0, "two views")
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=30)
    assert (process.returncode, error) == (130, "")
    told = json.loads(out)
    assert told["pictures"] == str(folder)
    kept = json.loads(Path(told["views"]).read_text())["views"]
    assert len(kept) >= 2
    assert cv2.imread(str(folder / kept[0]["name"])).shape == (480, 640, 3)
    code, again = calibrate(rig, "--images", str(folder), "--out", str(rig.parent / "again"))
    assert code == 3
    assert again["verdict"] == "not yet"
    code, again = calibrate(rig, "--live", "--views", told["views"], "--camera", "cam0", "--model", "5")
    assert (code, again["verdict"]) == (0, "good")
    assert {view["name"] for view in kept} <= {view["name"] for view in again["views"]} | {
        item["name"] for item in again["dropped"]
    }
    assert Path(again["pictures"]).name == "cam0-640x480-views-2"
    assert stack.processes == []


def test_a_camera_that_plays_for_recordings_only_says_what_to_do(rig: Path) -> None:
    (rig.parent / "photos").mkdir()
    cv2.imwrite(str(rig.parent / "photos" / "one.png"), cv2.imread(str(ROOT / "docs/how-to/marker-sheet.png")))
    code, told = calibrate(rig, "--camera", "still")
    assert (code, told["error"]["code"]) == (3, "no_camera")
    assert "--images" in told["error"]["message"]
    assert not (rig.parent / "calibration").exists()


def test_an_unknown_camera_is_refused_with_those_that_there_are(rig: Path) -> None:
    code, told = calibrate(rig, "--camera", "cam7")
    assert (code, told["error"]["code"]) == (78, "bad_config")
    assert "cam0" in told["error"]["message"]
