from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest

from common.errors import ConfigError
from tools.cli import main
from tools.evaluate.distance import PAPER, targets_of
from tools.evaluate.measured_distance import by_distance, measure, read_truth
from tools.evaluate.rendered_distance import FAR_MM, REAL_MM, joint, table_2
from tools.evaluate.spread import spread

RIG = """\
dataset: {root: ./dataset, session: measured}
markers: {family: 5x5_1000}
objects:
  - name: board
    size_mm: {width: 200, height: 200, depth: 5}
    sides:
      front: {marker: 403, marker_size_mm: 145, border_mm: 10}
cameras:
  cam0: {driver: files, path: ., calibration: cam.yaml}
"""
CALIBRATION = """\
width: 1280
height: 960
camera_matrix: [[1006.126, 0, 655.864], [0, 1004.015, 490.614], [0, 0, 1]]
distortion: [0.134974, -0.233587, 0.00067, 0.004847, 0.0]
"""


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG)
    (tmp_path / "cam.yaml").write_text(CALIBRATION)
    return tmp_path / "rig.yaml"


def test_spread_has_the_columns_of_the_paper():
    row = spread(500.0, [-1.0, 0.0, 2.0, 3.0], 5)
    assert (row.min, row.max, row.range, row.mean, row.mean_difference) == (499.0, 503.0, 4.0, 501.0, 1.0)
    assert row.sd == pytest.approx(math.sqrt(10 / 3))
    assert (row.found, row.frames) == (4, 5)


def test_spread_of_nothing_is_null_in_json():
    row = spread(500.0, [], 5)
    assert (row.found, row.frames) == (0, 5)
    assert row.plain()["mean"] is None
    json.dumps(row.plain(), allow_nan=False)


def test_rendered_distances_beat_what_is_asked():
    """A tenth of the frames; the whole of it is `tagmill evaluate distance`."""
    counted = []
    rows = list(table_2(3, 5, lambda: counted.append(1)))
    assert [row.real for row in rows] == list(REAL_MM) == sorted(PAPER)
    assert len(counted) == 5 * len(rows)
    for row in rows:
        assert row.found == 5
        assert abs(row.mean_difference) < 0.6 * row.real / FAR_MM
        assert row.min <= row.mean <= row.max
    targets = targets_of(rows, joint(3, 5, lambda: None))
    assert len(targets) == 5
    assert all(value < 2 * limit for _, value, limit, _ in targets)


def test_equal_seeds_give_equal_figures():
    rows = [next(table_2(seed, 2, lambda: None)) for seed in (7, 7, 8)]
    assert rows[0] == rows[1] != rows[2]


def test_a_photograph_of_known_distance(testdata, rig, tmp_path):
    picture = testdata("ubiquity/403.jpg")
    (tmp_path / "truth.csv").write_text("file, distance_mm\n403.jpg, 779.4\n")
    (found,) = measure(picture.parent, tmp_path / "truth.csv", rig, None)
    assert (found.marker, found.kind, found.remark) == (403, "photometric", "")
    assert found.estimate_mm == pytest.approx(779.4, abs=1.5)
    (row,) = by_distance([found])
    assert (row.real, row.found) == (779.4, 1)


def test_the_command_on_a_photograph(testdata, rig, tmp_path, capsys):
    folder = testdata("ubiquity/403.jpg").parent
    (tmp_path / "truth.yaml").write_text("- {file: 403.jpg, distance_mm: 779.4, marker: 403}\n")
    words = ["evaluate", "distance", "--folder", str(folder), "--truth", str(tmp_path / "truth.yaml")]
    assert main([*words, "--rig", str(rig), "--out", str(tmp_path / "report"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "report" / "distance.json").read_text())
    assert document["pictures"][0]["estimate_mm"] == pytest.approx(779.4, abs=1.5)
    assert "<svg" in (tmp_path / "report" / "distance.html").read_text()


def test_pictures_that_give_no_distance_say_why(rig, tmp_path):
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((960, 1280), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "small.png"), np.full((480, 640), 128, np.uint8))
    (tmp_path / "none.png").write_bytes(b"no picture")
    (tmp_path / "truth.csv").write_text("file,distance_mm\nempty.png,500\nsmall.png,500\nnone.png,500\n")
    empty, small, none = measure(tmp_path, tmp_path / "truth.csv", rig, "cam0")
    assert "no marker" in empty.remark
    assert "640x480" in small.remark
    assert "1280x960" in small.remark
    assert "no picture" in none.remark
    (row,) = by_distance([empty, small, none])
    assert (row.found, row.frames) == (0, 3)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("t.csv", "file,distance_mm\na.png,far\n", "distance_mm"),
        ("t.csv", "file,distance_mm\na.png\n", "distance_mm"),
        ("t.csv", "file,distance_mm,colour\na.png,3,red\n", "colour"),
        ("t.yaml", "- {file: a.png, distance_mm: -3}\n", "distance_mm"),
        ("t.yaml", "a: [1\n", "YAML"),
        ("t.yaml", "", "no list"),
    ],
)
def test_mistakes_in_the_truth_file_are_named(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_truth(tmp_path / name)
    assert said in " ".join([caught.value.message, *caught.value.problems])
    assert name in caught.value.message


def test_missing_files_are_all_named(rig, tmp_path):
    (tmp_path / "truth.csv").write_text("file,distance_mm\na.png,300\nb.png,400\n")
    with pytest.raises(ConfigError) as caught:
        measure(tmp_path, tmp_path / "truth.csv", rig, None)
    assert len(caught.value.problems) == 2
    with pytest.raises(ConfigError, match=r"nowhere\.csv"):
        read_truth(tmp_path / "nowhere.csv")


def test_a_camera_without_calibration_is_refused(tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG.replace(", calibration: cam.yaml", ""))
    (tmp_path / "truth.csv").write_text("file,distance_mm\n")
    with pytest.raises(ConfigError, match="no calibration"):
        measure(tmp_path, tmp_path / "truth.csv", tmp_path / "rig.yaml", None)


def test_pictures_need_a_rig(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", "distance", "--folder", str(tmp_path)]) == 78
    assert "--rig" in capsys.readouterr().err
