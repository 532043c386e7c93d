"""The recording benchmark's parts: both sides get the same frames, and the plain script does its work on them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config import load_rig
from common.config.models import SyntheticOptions
from services.capture.cameras.synthetic import SyntheticCamera
from tools.bench import plain_recorder
from tools.bench.processes import Usage
from tools.bench.record import Recorded, Result, _needed
from tools.bench.record_rig import CAMERA, render, save_for_script, write_rig
from tools.bench.record_table import print_record


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    save_for_script(write_rig(folder, folder / "data", paced=True, picture_format="png"), folder)
    return folder


def test_the_script_gets_the_frames_that_the_camera_gives(folder: Path) -> None:
    rig = load_rig(folder / "paced.yaml")
    camera = SyntheticCamera(CAMERA, rig.config.cameras[CAMERA], rig)
    given = [camera.grab(1.0) for _ in range(3)]
    colour, depth = render(folder / "paced.yaml")
    for number, grabbed in enumerate(given):
        assert np.array_equal(grabbed.bgr, colour[number])
        assert np.array_equal(grabbed.depth, depth[number])
    assert camera.describe().paced
    assert SyntheticOptions().pace == "fps"


def test_the_script_erases_both_markers_and_knows_where_the_box_is(folder: Path) -> None:
    output = plain_recorder.main(folder, 0.01)
    assert output["samples"] >= 1
    assert set(output["steps_ms"]) == {"detect", "pose", "erase", "encode", "write"}
    label = json.loads((folder / "out/label_000000.json").read_text())
    colour = np.load(folder / "frames.npz")["colour"][0]
    sides = [np.linalg.norm(np.subtract(quad[0], quad[1])) for quad in label["markers"].values()]
    assert all(70 < side < 100 for side in sides), "about 80 px"
    erased = cv2.imread(str(folder / "out/rgb_000000.png"))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    assert detector.detectMarkers(erased)[1] is None
    changed = cv2.absdiff(erased, colour).max(axis=2) > 0
    assert 2 * 70 * 70 < changed.sum() < 2 * 200 * 200, "nothing else is touched"
    rig = load_rig(folder / "paced.yaml")
    truth = SyntheticCamera(CAMERA, rig.config.cameras[CAMERA], rig).grab(1.0).truth
    assert truth is not None
    assert label["tvec_mm"] == pytest.approx(truth[0].tvec_mm, abs=15)


def test_room_is_asked_for_what_is_recorded() -> None:
    assert _needed("camera", 300) > 300 * 30 * 2_000_000
    assert _needed("both", 10) == _needed("camera", 10) + _needed("fastest", 10)


def test_the_cost_of_a_sample_is_told_by_service(capsys: pytest.CaptureFixture[str]) -> None:
    usages = {"label.0": Usage(90.0, 100.0, 3), "store": Usage(30.0, 100.0, 3)}
    numbers = {"captured": 300, "refused": {}, "dropped": {}, "samples_per_s": 30.0, "megabytes_per_s": 60.0}
    recorded = Recorded(seconds=10.0, recorded=300, steps_ms={}, processes=usages, checked=0, **numbers)
    assert recorded.cpu_ms() == pytest.approx({"label.0": 30.0, "store": 10.0})
    print_record(Result("plane", "telea", "png", camera=recorded), 10.0)
    printed = capsys.readouterr().out
    assert "service, with its workers" in printed
    assert "40.0" in printed.split("Fill")[0]
