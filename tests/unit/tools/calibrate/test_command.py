"""`tagmill calibrate` as a person uses it, with the mistakes a person makes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from common.boards import Board
from common.calibration import View
from common.calibration.kept import save_views
from common.config import read_calibration
from common.config.quality import Quality
from common.labels import CameraLabel
from tests.unit.common.calibration.synthetic import Camera
from tools.calibrate import search
from tools.calibrate.convert import write_as
from tools.cli import main

BOARD = Board(kind="chessboard", columns=9, rows=6, square_mm=25)
CHESS = ("--board", "chessboard", "--size", "9x6", "--square-mm", "25")


@pytest.fixture
def views(tmp_path: Path) -> Path:
    path = tmp_path / "kept.views.json"
    save_views(path, BOARD, Camera(noise_px=0.1).good_views(np.random.default_rng(1), 20))
    return path


def answered(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> dict[str, Any]:
    assert main(["calibrate", *words, "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def blank(folder: Path, count: int = 3) -> Path:
    folder.mkdir()
    for number in range(count):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((240, 320), 90, np.uint8))
    return folder


def test_kept_views_become_a_calibration_with_its_report(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["calibrate", "--views", str(views), "--camera", "cam0", "--serial", "0815", "--model", "5"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("GOOD\n")
    assert "A wrong square size can't be seen in pictures" in said
    path = tmp_path / "cam0-1280x720.yaml"
    label = read_calibration(path, "cam0")
    assert label.serial == "0815"
    quality = Quality.model_validate(yaml.safe_load(path.read_text())["quality"])
    assert (quality.verdict, quality.views, quality.lens) == ("good", 20, "5")
    assert set(quality.sd) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}
    assert "<h1>Calibration of cam0: good</h1>" in (tmp_path / "cam0-1280x720.html").read_text()
    # Once more: what was there is set aside, not lost.
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert read_calibration(tmp_path / "cam0-1280x720.previous.yaml", "cam0") == label


def test_a_wrong_square_size_shows_by_a_measured_distance_only(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--views", str(views), "--model", "5", "--out", str(tmp_path))
    right = answered(capsys, *words)
    (first,) = [view for view in right["views"] if view["name"] == "00"]
    distance = first["distance_mm"]
    assert answered(capsys, *words, "--measured", f"00={distance * 1.01:.1f}")["verdict"] == "good"
    wrong = answered(capsys, *words, "--measured", f"00={distance * 1.2:.1f}", code=3)
    (reason,) = wrong["reasons"]
    assert reason["code"] == "wrong_size"
    assert "the board's sizes are 1.200 times what was given" in reason["words"]


def test_a_hopeless_set_is_refused_and_nothing_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "few.json"
    save_views(path, BOARD, Camera().good_views(np.random.default_rng(1), 4))
    found = answered(capsys, "--views", str(path), "--model", "2", "--out", str(tmp_path / "out"), code=3)
    assert found["reasons"][0]["code"] == "few"
    assert found["file"] is None
    assert Path(found["report"]).is_file()
    assert sorted(one.suffix for one in (tmp_path / "out").iterdir()) == [".html", ".json"]
    found = answered(capsys, "--views", str(path), "--model", "2", "--out", str(tmp_path / "out"), "--anyway", code=3)
    assert Path(found["file"]).is_file()


def test_pictures_without_the_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = blank(tmp_path / "shots")
    (folder / "torn.png").write_bytes(b"\x89PNG")
    found = answered(capsys, "--images", str(folder), *CHESS, "--out", str(tmp_path), code=3)
    assert found["verdict"] == "not yet"
    assert {reason["code"] for reason in found["reasons"]} & {"no_board", "blurred"}
    assert [miss["code"] for miss in found["missed"]][-1] == "unreadable"


def test_ctrl_c_keeps_the_views(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = iter(Camera().good_views(np.random.default_rng(1), 2))

    class Finder:
        """Two views, then the key."""

        def __init__(self, *_: object, **__: object) -> None: ...

        def find(self, *_: object) -> View:
            view = next(made, None)
            if view is None:
                raise KeyboardInterrupt
            return view

    monkeypatch.setattr(search, "BoardFinder", Finder)
    folder = blank(tmp_path / "shots")
    assert main(["calibrate", "--images", str(folder), *CHESS, "--out", str(tmp_path)]) == 130
    said = capsys.readouterr().out
    kept = tmp_path / "camera-1280x720.views.json"
    assert f"2 views are kept in {kept}; go on with --views {kept}" in said
    assert len(json.loads(kept.read_text())["views"]) == 2


def test_a_place_that_can_t_be_written_is_told_before_the_work(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["calibrate", "--views", str(views), "--out", str(tmp_path / "file" / "below")]) == 3
    assert "can't be written: Not a directory; choose another place with --out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 78, "which board? --board FILE"),
        (("--board", "chessboard"), 78, "--size must be columns x rows, like 9x6"),
        (("--board", "chessboard", "--size", "9x6"), 78, "needs square_mm"),
        (CHESS, 78, "where are the pictures?"),
        ((*CHESS, "--images", "nowhere/*.jpg"), 3, "no file fits nowhere/*.jpg"),
        ((*CHESS, "--video", "nowhere.mp4"), 3, "nowhere.mp4 does not exist"),
        ((*CHESS, "--views", "nowhere.json"), 3, "can't be read"),
        ((*CHESS, "--images", ".", "--measured", "a"), 3, "--measured must be NAME=MM"),
        ((*CHESS, "--images", ".", "--window", "0"), 3, "--window must be at least 1"),
        (("--board", "nowhere.yaml", "--images", "."), 78, "nowhere.yaml"),
    ],
)
def test_mistakes_in_the_command_line(
    words: tuple[str, ...], code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *words]) == code
    assert says in capsys.readouterr().err


# --- convert

PINHOLE = CameraLabel(
    name="cam0",
    width=1280,
    height=720,
    matrix=((905.123456789, 0.0, 640.5), (0.0, 906.25, 355.125), (0.0, 0.0, 1.0)),
    distortion=(0.1, -0.2, 0.001, -0.0012345678901, 0.05),
    serial="0815",
)
RATIONAL = PINHOLE.model_copy(update={"distortion": (0.1, -0.2, 0.001, -0.001, 0.05, 0.3, -0.1, 0.01)})
FISHEYE = PINHOLE.model_copy(update={"distortion": (0.1, -0.2, 0.01, -0.01), "model": "fisheye"})


@pytest.mark.parametrize("label", [PINHOLE, RATIONAL, FISHEYE], ids=["5", "8", "fisheye"])
@pytest.mark.parametrize("form", ["opencv", "ros", "tagmill"])
def test_each_format_gives_back_what_went_in(label: CameraLabel, form: str, tmp_path: Path) -> None:
    path = tmp_path / f"cam.{'yml' if form == 'opencv' else 'yaml'}"
    write_as(form, path, label)
    again = read_calibration(path, "cam0")
    assert again == label.model_copy(update={"serial": None if form == "ros" else "0815"})
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_others_read_what_is_written(tmp_path: Path) -> None:
    write_as("opencv", tmp_path / "cam.yml", PINHOLE)
    storage = cv2.FileStorage(str(tmp_path / "cam.yml"), cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("camera_matrix").mat(), np.array(PINHOLE.matrix))
    assert storage.getNode("distortion_coefficients").mat().shape == (5, 1)
    storage.release()
    write_as("ros", tmp_path / "cam.yaml", RATIONAL)
    info = yaml.safe_load((tmp_path / "cam.yaml").read_text())
    assert (info["distortion_model"], info["distortion_coefficients"]["cols"]) == ("rational_polynomial", 8)
    assert info["projection_matrix"]["data"][3::4] == [0.0, 0.0, 0.0]


def test_the_convert_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "cam0-1280x720.yaml"
    write_as("tagmill", source, PINHOLE)
    assert main(["calibrate", "convert", str(source), "--to", "ros"]) == 0
    said = capsys.readouterr().out
    assert f"written: {tmp_path / 'cam0-1280x720-ros.yaml'}" in said
    assert "has no serial number" in said
    assert main(["calibrate", "convert", str(source), "--to", "tagmill", "--out", str(source)]) == 3
    assert "would be overwritten with itself" in capsys.readouterr().err
    twelve = PINHOLE.model_copy(update={"distortion": (0.1,) * 12})
    write_as("tagmill", source, twelve)
    assert main(["calibrate", "convert", str(source), "--to", "ros"]) == 3
    assert "ROS knows 5 or 8 pinhole coefficients, not 12" in capsys.readouterr().err
