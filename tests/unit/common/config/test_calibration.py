"""Calibration files of three worlds, and what is said about broken ones."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.config import read_calibration, write_calibration
from common.errors import ConfigError
from common.labels import CameraLabel

MATRIX = ((900.5, 0.0, 639.5), (0.0, 901.25, 359.5), (0.0, 0.0, 1.0))
DISTORTION = (0.1, -0.2, 0.001, -0.001, 0.05)

PLAIN = """\
width: 1280
height: 720
camera_matrix: [[900.5, 0, 639.5], [0, 901.25, 359.5], [0, 0, 1]]
distortion: [0.1, -0.2, 0.001, -0.001, 0.05]
serial: "0815"
quality: {rms_px: 0.2, views: 31}
"""
ROS = """\
image_width: 1280
image_height: 720
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [900.5, 0, 639.5, 0, 901.25, 359.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.001, -0.001, 0.05]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
ROS_MESSAGE = """\
header: {seq: 1, frame_id: camera}
height: 720
width: 1280
distortion_model: plumb_bob
D: [0.1, -0.2, 0.001, -0.001, 0.05]
K: [900.5, 0.0, 639.5, 0.0, 901.25, 359.5, 0.0, 0.0, 1.0]
"""


def file_storage(path: Path, size: str = "image_width") -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if size == "image_width":
        storage.write("image_width", 1280)
        storage.write("image_height", 720)
    storage.write("camera_matrix", np.array(MATRIX))
    storage.write("distortion_coefficients", np.array([DISTORTION]).T)
    storage.release()
    return path


def check(label: CameraLabel) -> None:
    assert (label.name, label.width, label.height, label.model) == ("cam0", 1280, 720, "pinhole")
    assert label.matrix == MATRIX
    assert label.distortion == DISTORTION
    assert label.intrinsics_from == "calibration"


@pytest.mark.parametrize("text", [PLAIN, ROS, ROS_MESSAGE], ids=["plain", "ros", "ros message"])
def test_yaml_forms(text: str, tmp_path: Path) -> None:
    path = tmp_path / "cal.yaml"
    path.write_text(text)
    check(read_calibration(path, "cam0"))


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
def test_what_cv2_writes(suffix: str, tmp_path: Path) -> None:
    check(read_calibration(file_storage(tmp_path / f"cal.{suffix}"), "cam0"))


def test_a_file_without_a_size_takes_the_rig_s(tmp_path: Path) -> None:
    path = file_storage(tmp_path / "cal.yml", size="none")
    check(read_calibration(path, "cam0", (1280, 720)))
    with pytest.raises(ConfigError, match="width: is missing"):
        read_calibration(path, "cam0")


def test_plain_json_and_serial(tmp_path: Path) -> None:
    path = tmp_path / "cal.json"
    document = {"width": 1280, "height": 720, "camera_matrix": MATRIX, "distortion": DISTORTION, "serial": 815}
    path.write_text(json.dumps(document))
    label = read_calibration(path, "cam0")
    check(label)
    assert label.serial == "815"


def test_fisheye_of_tagmill_and_of_ros(tmp_path: Path) -> None:
    path = tmp_path / "cal.yaml"
    plain = PLAIN.replace(", 0.05]", "]") + "model: fisheye\n"
    ros = ROS.replace("plumb_bob", "equidistant").replace("-0.001, 0.05]", "-0.001]")
    for text in (plain, ros):
        path.write_text(text)
        label = read_calibration(path, "cam0")
        assert (label.model, len(label.distortion)) == ("fisheye", 4)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("width: 1280\n", "", ": width: is missing"),
        ("width: 1280", "width: 1280.5", ":1: width: must be a whole number of pixels"),
        ("width: 1280", "width: true", ":1: width: must be a whole number of pixels from 1 to 65535, not true"),
        ("height: 720", "height: 0", ":2: height: must be a whole number"),
        ("camera_matrix", "camera_matix", "camera_matrix: is missing (there is 'camera_matix')"),
        ("[0, 0, 1]]", "[0, 0]]", ":3: camera_matrix: must be 3x3"),
        ("900.5", "wide", ":3: camera_matrix: must be 3x3 finite numbers"),
        ("900.5", "-900", ":3: camera_matrix: fx and fy must be greater than 0"),
        ("900.5", ".nan", ":3: camera_matrix[0][0]: .nan is not allowed"),
        ("[900.5, 0,", "[900.5, 3,", ":3: camera_matrix: has a skew of 3"),
        ("[[900.5, 0, 639.5], [0, 901.25, 359.5], [0, 0, 1]]", "[[900.5, 0, 0], [0, 901.25, 0], [639.5, 359.5, 1]]",
         "is it transposed?"),
        ("639.5", "6395", "far outside a picture of 1280 x 720"),
        ("distortion:", "distort:", "distortion: is missing"),
        ("[0.1, -0.2, 0.001, -0.001, 0.05]", "[0.1, -0.2]", ":4: distortion: has 2 values; OpenCV knows 0, 4, 5"),
        ("[0.1, -0.2, 0.001, -0.001, 0.05]", "none", ":4: distortion: must be a list of finite numbers"),
        ("serial", "model: fishy\nserial", ":5: model: 'fishy' is not known"),
        ("serial", "model: fisheye\nserial", ":4: distortion: has 5 values; a fisheye has the 4"),
        (PLAIN, "- 1\n", ":1: must be a map"),
        (PLAIN, "", "is empty"),
    ],
)  # fmt: skip
def test_a_broken_file_is_told_with_its_field(old: str, new: str, says: str, tmp_path: Path) -> None:
    assert old in PLAIN
    path = tmp_path / "cal.yaml"
    path.write_text(PLAIN.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        read_calibration(path, "cam0")
    (problem,) = caught.value.problems
    assert problem.startswith(str(path))
    assert says in problem


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("cal.yml", "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: [", "can't be read"),
        ("cal.xml", "<?xml version='1.0'?><opencv_storage><a>", "can't be read"),
        ("cal.xml", "<?xml version='1.0'?><other/>", "FileStorage"),
        ("cal.json", '{"width": 5,', ":1: is no valid JSON"),
        ("cal.json", '{"width": NaN, "height": 1}', "finite"),
        ("cal.json", '{"a":' + "[" * 100_000, "nested too deeply"),
        # OpenCV's own readers end these with a segmentation fault, or reserve 12 GB.
        ("cal.yml", "%YAML:1.0\n---\na: " + "[" * 100_000, "nested deeper than"),
        ("cal.yml", "%YAML:1.0\n---\n" + "".join(" " * depth + "a:\n" for depth in range(600)), "nested deeper than"),
        ("cal.xml", "<?xml version='1.0'?><opencv_storage>" + "<a>" * 3000, "nested deeper than"),
        ("cal.xml", "<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a 'b'>]><opencv_storage/>", "document type"),
        (
            "cal.yml",
            "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 40000\n   cols: 40000\n   data: [ 1. ]\n",
            "camera_matrix: must be 3x3",
        ),
        ("cal.yml", "%YAML:1.0\n---\na: &x [1]\nb: *x\n", "aliases"),
        ("cal.yml", "%YAML:1.0\n---\na: 1\na: 2\n", "'a' is given twice"),
        ("cal.json", '{"width": ' + "9" * 5000 + "}", "integer"),
        ("cal.json", '{"width": ' + "9" * 400 + "}", "finite"),
        ("cal.json", '{"serial": "\\ud800"}', "control character"),
    ],
)
def test_a_damaged_file_of_another_world(name: str, content: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ConfigError) as caught:
        read_calibration(path, "cam0")
    assert any(says in problem for problem in caught.value.problems), caught.value.problems


def test_all_mistakes_of_a_calibration_at_once_and_in_the_rig(tmp_path: Path) -> None:
    path = tmp_path / "cal.yaml"
    path.write_text(PLAIN.replace("1280", "none").replace("900.5", "-1").replace("0.05]", "0.05, 1]"))
    with pytest.raises(ConfigError) as caught:
        read_calibration(path, "cam0")
    assert len(caught.value.problems) == 3


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    focal=st.floats(10, 20000),
    centre=st.tuples(st.floats(0, 639), st.floats(0, 479)),
    distortion=st.lists(st.floats(-30, 30), min_size=5, max_size=5),
    serial=st.none() | st.text(st.characters(categories=("L", "N", "P")), min_size=1, max_size=12),
)
def test_what_is_written_is_read_back(
    focal: float, centre: tuple[float, float], distortion: list[float], serial: str | None, tmp_path: Path
) -> None:
    label = CameraLabel(
        name="cam0",
        width=640,
        height=480,
        matrix=((focal, 0.0, centre[0]), (0.0, focal, centre[1]), (0.0, 0.0, 1.0)),
        distortion=tuple(distortion),
        serial=serial,
    )
    path = tmp_path / "cal.yaml"
    write_calibration(path, label, {"rms_px": 0.25, "views": 30})
    assert read_calibration(path, "cam0") == label
    assert [one.name for one in tmp_path.iterdir()] == ["cal.yaml"]


@pytest.mark.parametrize("serial", ["0815", "815", "1e3", "0x1F", "yes", 'a"b', "é", "usb: 3"])
def test_a_serial_stays_the_text_it_is(serial: str, tmp_path: Path) -> None:
    label = CameraLabel(name="a", width=1280, height=720, matrix=MATRIX, distortion=(), serial=serial)
    write_calibration(tmp_path / "cal.yaml", label, {"rms_px": 0.25})
    assert read_calibration(tmp_path / "cal.yaml", "a").serial == serial


def test_a_calibration_that_can_t_be_written(tmp_path: Path) -> None:
    label = CameraLabel(name="a", width=640, height=480, matrix=MATRIX, distortion=())
    with pytest.raises(ConfigError, match="can't be written"):
        write_calibration(tmp_path / "missing" / "cal.yaml", label)


@pytest.mark.parametrize(
    ("name", "fx"), [("tutorial_camera_charuco.yml", 452.51), ("tutorial_camera_params.yml", 628.158)]
)
def test_opencv_s_published_intrinsics(name: str, fx: float, testdata: Callable[[str], Path]) -> None:
    label = read_calibration(testdata(f"opencv/{name}"), "cam0", (640, 480))
    assert label.matrix[0][0] == pytest.approx(fx, abs=0.005)
    assert len(label.distortion) == 5
