"""The YOLO family: what its loaders want, and that it says what the labels say."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tests.support.recorded import HEIGHT, WIDTH, label_of, moving, write_session
from tests.unit.tools.export.conftest import Export


@pytest.mark.parametrize(("name", "columns"), [("yolo", 5), ("yolo-pose", 29), ("yolo-obb", 9), ("yolo-segment", None)])
def test_each_row_is_one_that_the_loader_takes(
    session60: Path, tmp_path: Path, export: Export, name: str, columns: int | None
) -> None:
    told = export(name, session60, out=tmp_path / "out")
    assert told["checks"]["wrong"] == []
    data = yaml.safe_load((tmp_path / "out" / "data.yaml").read_text())
    for part in ("train", "val"):
        pictures = sorted(path.stem for path in (tmp_path / "out" / data[part]).iterdir())
        labels = sorted((tmp_path / "out" / "labels" / part).iterdir())
        assert pictures == [path.stem for path in labels]
        assert len(pictures) == told["samples"][part]
        for path in labels:
            for line in path.read_text().splitlines():
                values = [float(value) for value in line.split()]
                assert int(values[0]) in data["names"]
                assert all(0 <= value <= 2 for value in values[1:])
                assert len(values) == columns if columns else (len(values) >= 7 and len(values) % 2)
    assert sum(told["samples"].values()) + told["left_out"].get("neighbour", 0) == 60


def test_a_window_is_the_share_of_the_picture_with_edges_at_0_and_1(tmp_path: Path, export: Export) -> None:
    label = label_of(0, {"box-1": moving(0)["box-1"]})
    write_session(tmp_path / "s", [(label, {"rgb": np.zeros((HEIGHT, WIDTH, 3), np.uint8)})])
    export("yolo", tmp_path / "s", "--split", "none", out=tmp_path / "out")
    line = next((tmp_path / "out" / "labels" / "train").iterdir()).read_text().split()
    window = label.objects[0].window
    assert window is not None
    assert float(line[1]) == pytest.approx(((window.x_min + window.x_max) / 2 + 0.5) / WIDTH, abs=1e-6)
    assert float(line[4]) == pytest.approx((window.y_max - window.y_min) / HEIGHT, abs=1e-6)


def test_corners_outside_are_written_as_0_0_0(session60: Path, tmp_path: Path, export: Export) -> None:
    export("yolo-pose", session60, out=tmp_path / "out")
    rows = [line for path in (tmp_path / "out" / "labels").rglob("*.txt") for line in path.read_text().splitlines()]
    points = np.array([row.split()[5:] for row in rows], dtype=float).reshape(-1, 3)
    outside = points[points[:, 2] == 0]
    assert len(outside) > 10
    assert (outside == 0).all()
    assert {0.0, 1.0, 2.0} == set(points[:, 2])


def test_darknet_finds_its_labels_whatever_the_folders_are_called(
    session60: Path, tmp_path: Path, export: Export
) -> None:
    out = tmp_path / "my images" / "JPEGImages größer"
    export("yolo", session60, out=out)
    lists = {name: (out / name).read_text().splitlines() for name in ("train.txt", "valid.txt")}
    for lines in lists.values():
        for line in lines:
            assert (out / line).is_file()
            assert (out / line.replace("images", "labels", 1)).with_suffix(".txt").is_file()
    assert (out / "obj.names").read_text().splitlines() == ["front", "back", "left", "right"]


def test_an_object_behind_another_keeps_its_visible_piece(session60: Path, tmp_path: Path, export: Export) -> None:
    """Against the depth picture, which was made from the faces' planes and not from outlines."""
    export("yolo-segment", session60, "--classes", "type", "--split", "none", out=tmp_path / "out")
    worst = 1.0
    for path in sorted((tmp_path / "out" / "labels" / "train").iterdir()):
        depth = cv2.imread(str(session60 / "depth" / f"depth_{path.stem}.png"), cv2.IMREAD_UNCHANGED)
        drawn = np.zeros((HEIGHT, WIDTH), np.uint8)
        for line in path.read_text().splitlines():
            points = np.array(line.split()[1:], float).reshape(-1, 2) * [WIDTH, HEIGHT] - 0.5
            cv2.fillPoly(drawn, [np.round(points).astype(np.int32)], 1)
        truth = depth < 4000
        worst = min(worst, (truth & (drawn > 0)).sum() / (truth | (drawn > 0)).sum())
    assert worst > 0.93
