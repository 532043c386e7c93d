"""Splits don't leak: whole units, near-duplicates on one side, refused where that can't be."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.geometry import Pose
from common.quality import ALIKE_BITS, differing_bits, near_views, perceptual_hash
from tests.support.recorded import Painter, camera_label, label_of, moving, samples, write_session
from tests.unit.tools.export.conftest import Export
from tools.cli import main


def parts_of(out: Path) -> dict[str, str]:
    """Each sample's part."""
    rows = json.loads((out / "tagmill-export.json").read_text())["samples"]
    return {row["sample"]: row["part"] for row in rows.values()}


def near_pairs(session: Path, parts: dict[str, str]) -> int:
    """Pairs across parts that show the same, looked for one by one."""
    rows = []
    for sample, part in parts.items():
        label = json.loads((session / "label" / f"label_{sample}.json").read_text())
        poses = {
            item["name"]: Pose.from_rvec(item["pose"]["rvec"], item["pose"]["tvec_mm"]) for item in label["objects"]
        }
        hash_ = perceptual_hash(cv2.imread(str(session / "rgb" / f"rgb_{sample}.png")))
        rows.append((part, poses, hash_))
    return sum(
        one[0] != other[0]
        and bool(near_views([one[1]], [other[1]])[0, 0])
        and int(differing_bits(one[2], np.array([other[2]], np.uint64))[0]) <= ALIKE_BITS
        for i, one in enumerate(rows)
        for other in rows[:i]
    )


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session in which neighbours are near-duplicates: the boxes move by a twentieth of a step."""
    folder = tmp_path_factory.mktemp("slow") / "slow"
    write_session(folder, samples(120, step=0.05, depth=False))
    return folder


def test_neighbours_at_the_seams_are_taken_out_of_the_training_set(slow: Path, tmp_path: Path, export: Export) -> None:
    told = export("yolo", slow, "--no-check", out=tmp_path / "out")
    parts = parts_of(tmp_path / "out")
    assert told["left_out"]["neighbour"] > 0
    assert len(parts) + told["left_out"]["neighbour"] == 120
    assert {"train", "val"} == set(parts.values())
    assert near_pairs(slow, parts) == 0
    split = json.loads((tmp_path / "out" / "tagmill-export.json").read_text())["split"]
    assert split["seed"] == 1
    assert any("near-duplicates" in reason for reason in split["reasons"])
    assert sum(unit["samples"] + unit["neighbours_left_out"] for unit in split["units"].values()) == 120


def test_the_same_seed_gives_the_same_split_and_another_another(
    session60: Path, tmp_path: Path, export: Export
) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        export("yolo", session60, "--seed", str(seed), "--no-check", "--test", "0.1", out=tmp_path / name)
    first, again, other = (parts_of(tmp_path / name) for name in "abc")
    assert first == again
    assert first != other
    assert set(first.values()) == {"train", "val", "test"}


def test_a_time_block_is_never_torn(session60: Path, tmp_path: Path, export: Export) -> None:
    export("yolo", session60, "--no-check", out=tmp_path / "out")
    parts = [part for _, part in sorted(parts_of(tmp_path / "out").items())]
    changes = sum(one != other for one, other in itertools.pairwise(parts))
    assert changes <= 2 * parts.count("val") / 5


def test_a_standing_scene_gives_no_validation_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    painter, poses = Painter(), moving(3)
    picture = painter.paint(poses)["rgb"]
    write_session(tmp_path / "s", ((label_of(number, poses), {"rgb": picture}) for number in range(24)))
    assert main(["export", "yolo", str(tmp_path / "s"), "--out", str(tmp_path / "out")]) == 3
    assert "that would be no validation set" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_sessions_and_cameras_are_units(tmp_path: Path, export: Export) -> None:
    painter = Painter()
    for day in range(3):
        rows = []
        for number in range(8):
            poses = moving(100 * day + 3 * number)
            camera = camera_label(f"cam{number % 2}")
            rows.append((label_of(1000 * day + number, poses, camera=camera), {"rgb": painter.paint(poses)["rgb"]}))
        write_session(tmp_path / f"day{day}", rows)
    days = [tmp_path / f"day{day}" for day in range(3)]
    told = export("yolo", *days, "--no-check", out=tmp_path / "out")
    assert told["split"]["by"] == "session"
    assert sorted(unit["samples"] for unit in told["split"]["units"].values()) == [8, 8, 8]
    assert len([unit for unit in told["split"]["units"].values() if unit["part"] == "val"]) == 1
    told = export("yolo", *days, "--split", "camera", "--no-check", out=tmp_path / "cameras")
    assert set(told["split"]["units"]) == {"cam0", "cam1"}
