"""Every format: in one go, read back within its rounding, left alone by a second run; and its particulars."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import DatasetError
from common.geometry import CameraModel, Pose
from common.labels import DepthLabel
from tests.support.recorded import (
    BOXES,
    HEIGHT,
    WIDTH,
    Painter,
    camera_label,
    label_of,
    make_box,
    moving,
    samples,
    write_session,
)
from tests.unit.tools.export.conftest import Export, tree
from tools.export.formats.bop_rules import check_bop
from tools.export.formats.singleshotpose import folders
from tools.export.registry import known_formats

FORMATS = ("yolo", "yolo-pose", "yolo-obb", "yolo-segment", "coco", "bop", "kitti", "singleshotpose", "dope")


def test_these_are_all_formats() -> None:
    assert known_formats() == FORMATS


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_is_right_and_a_second_run_changes_nothing(
    session60: Path, tmp_path: Path, export: Export, name: str
) -> None:
    out = tmp_path / "a folder für größere Dinge"
    told = export(name, session60, out=out)
    assert told["checks"]["wrong"] == []
    found = told["checks"]["reprojection"]
    assert found["targets"] == sum(told["classes"].values()) > 80
    if name != "kitti":  # whose loss of roll and pitch is told
        assert found["worst_px"] <= 0.5
    before = tree(out)
    again = export(name, session60, out=out)
    assert again["files"] == {"written": 0, "linked": 0, "kept": told["files"]["written"], "removed": 0}
    assert again["need_bytes"] == 0
    assert tree(out) == before


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("letterbox", [False, True])
def test_a_resized_export_is_right_as_well(
    session12: Path, tmp_path: Path, export: Export, name: str, letterbox: bool
) -> None:
    words = ["--size", "200x200", *(["--letterbox"] if letterbox else []), "--val", "0", "--max-distance-mm", "2900"]
    told = export(name, session12, *words, out=tmp_path / "out")
    assert told["checks"]["wrong"] == []
    pictures = [
        path
        for path in (tmp_path / "out").rglob("*.png")
        if {"images", "rgb", "train", "image_2", "JPEGImages"} & {*path.parts}
    ]
    assert pictures
    for path in pictures[:3]:
        assert cv2.imread(str(path)).shape == (200, 200, 3)


def test_bop_masks_and_counts_are_what_the_depth_shows(session12: Path, tmp_path: Path, export: Export) -> None:
    """The mask of what is visible against the undistorted depth picture, which the faces' planes made."""
    told = export("bop", session12, "--split", "none", out=tmp_path / "out")
    assert any("own check" in line for line in told["checks"]["right"])
    scene = tmp_path / "out" / "train" / "000001"
    worst = 1.0
    for image in range(12):
        depth = cv2.imread(str(scene / "depth" / f"{image:06d}.png"), cv2.IMREAD_UNCHANGED)
        masks = [cv2.imread(str(path), 0) > 0 for path in sorted((scene / "mask_visib").glob(f"{image:06d}_*.png"))]
        shown = np.logical_or.reduce(masks)
        truth = (depth > 0) & (depth < 4000)
        worst = min(worst, (shown & truth).sum() / (shown | truth).sum())
        assert np.sum(masks, axis=0).max() <= 1
    assert worst > 0.9  # half a pixel around objects 50 px large, and faces seen along their surface
    info = json.loads((scene / "scene_gt_info.json").read_text())
    cut = [row for rows in info.values() for row in rows if row["bbox_obj"][0] < 0 <= row["bbox_visib"][0]]
    assert cut
    assert all(row["px_count_all"] > row["px_count_visib"] for row in cut)


def test_bop_masks_are_told_to_coco_as_well(session12: Path, tmp_path: Path, export: Export) -> None:
    """pycocotools, which reads this file in BOP's own evaluation, decodes the very masks."""
    from pycocotools.coco import COCO

    export("bop", session12, "--split", "none", out=tmp_path / "out")
    scene = tmp_path / "out" / "train" / "000001"
    coco, info = COCO(str(scene / "scene_gt_coco.json")), json.loads((scene / "scene_gt_info.json").read_text())
    assert len(coco.getImgIds()) == 12
    seen = 0
    for image in coco.getImgIds():
        assert (scene / coco.imgs[image]["file_name"]).is_file()
        rows = coco.loadAnns(coco.getAnnIds(imgIds=[image]))
        for number, (row, about) in enumerate(zip(rows, info[str(image)], strict=True)):
            mask = cv2.imread(str(scene / "mask_visib" / f"{image:06d}_{number:06d}.png"), 0) > 0
            assert (coco.annToMask(row).astype(bool) == mask).all()
            assert row["ignore"] == (about["visib_fract"] < 0.1)
            seen += int(mask.sum())
    assert seen > 0


@pytest.mark.parametrize("name", ["bop", "kitti", "dope", "singleshotpose"])
def test_a_fisheye_becomes_a_pinhole(tmp_path: Path, export: Export, name: str) -> None:
    """Formats without a lens get undistorted pictures: what is painted through the fisheye lies where they say."""
    camera = camera_label(distortion=(0.06, -0.03, 0.01, -0.002)).model_copy(update={"model": "fisheye"})
    painter, unit, rows = Painter(camera), DepthLabel(unit_mm=1.0), []
    for number in range(6):
        poses = moving(number)
        rows.append((label_of(number, poses, camera=camera, depth=unit), painter.paint(poses)))
    write_session(tmp_path / "s", rows)
    told = export(name, tmp_path / "s", "--split", "none", out=tmp_path / "out")
    assert told["checks"]["wrong"] == []
    if name != "kitti":  # whose loss of roll and pitch is told
        assert told["checks"]["reprojection"]["worst_px"] <= 0.5
    if name == "bop":
        scene = tmp_path / "out" / "train" / "000001"
        for image in range(6):
            depth = cv2.imread(str(scene / "depth" / f"{image:06d}.png"), cv2.IMREAD_UNCHANGED)
            masks = [cv2.imread(str(path), 0) > 0 for path in sorted((scene / "mask_visib").glob(f"{image:06d}_*.png"))]
            shown, truth = np.logical_or.reduce(masks), (depth > 0) & (depth < 4000)
            assert (shown & truth).sum() / (shown | truth).sum() > 0.9


def test_a_broken_rule_of_bop_is_found(session12: Path, tmp_path: Path, export: Export) -> None:
    export("bop", session12, out=tmp_path / "out")
    path = next((tmp_path / "out" / "train" / "000001" / "mask_visib").iterdir())
    picture = cv2.imread(str(path), 0)
    picture[:3, :3] = 255 - picture[:3, :3]
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    with pytest.raises(DatasetError, match="against BOP's rules"):
        check_bop(tmp_path / "out", ("train", "val"))


def test_kitti_is_exact_for_boxes_that_stand_upright(tmp_path: Path, export: Export) -> None:
    """In the camera's own upright: only then KITTI's yaw says everything."""
    painter = Painter()
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    rows = []
    for number in range(8):
        turn = Pose.from_rvec([0.0, 0.0, 0.8 * number], np.zeros(3)).rotation
        poses = {"box-1": Pose(upright @ turn, np.array([40.0 * number - 150, 30.0, 1900.0]))}
        rows.append((label_of(number, poses), {"rgb": painter.paint(poses)["rgb"]}))
    write_session(tmp_path / "s", rows)
    told = export("kitti", tmp_path / "s", "--split", "none", out=tmp_path / "out")
    assert told["checks"]["reprojection"]["worst_px"] < 0.1
    assert "0.0 at most" in told["notes"][-1]


def test_singleshotpose_orders_corners_with_x_slowest_and_z_fastest(
    session12: Path, tmp_path: Path, export: Export
) -> None:
    export("singleshotpose", session12, "--split", "none", out=tmp_path / "out")
    root = tmp_path / "out" / "LINEMOD" / "box"
    intrinsics = json.loads((root / "intrinsics.json").read_text())
    row = np.array((root / "labels" / "1.txt").read_text().split(), dtype=float)
    assert len(row) == 21
    width, height, depth = (value / 1000 for value in BOXES[0].size_mm)
    corners = [(x, y, z) for x in (-width, width) for y in (-depth, depth) for z in (-height, height)]
    pose = np.load(root / "transforms" / "1.npy")
    xyz = np.vstack([np.zeros(3), np.array(corners) / 2]) @ pose[:3, :3].T + pose[:3, 3]
    x = xyz[:, 0] / xyz[:, 2] * intrinsics["fx"] + intrinsics["ppx"]
    y = xyz[:, 1] / xyz[:, 2] * intrinsics["fy"] + intrinsics["ppy"]
    stored = row[1:19].reshape(-1, 2) * [WIDTH, HEIGHT] - 0.5
    assert np.abs(stored - np.column_stack([x, y])).max() < 0.01


def test_dope_has_its_front_top_right_corner_first(session12: Path, tmp_path: Path, export: Export) -> None:
    export("dope", session12, "--split", "none", out=tmp_path / "out")
    label = next(path for path in sorted((tmp_path / "out" / "train").glob("2*.json")))
    plain = json.loads(label.read_text())
    stored = json.loads((session12 / "label" / f"label_{label.stem}.json").read_text())
    model = CameraModel.from_label(camera_label())
    for row, item in zip(plain["objects"], stored["objects"], strict=True):
        corner = next(corner for corner in item["corners"] if corner["name"] == "front_top_right")
        flat = model.normalise([[corner["x"], corner["y"]]]) @ model.matrix[:2, :2].T + model.matrix[:2, 2]
        assert np.allclose(row["projected_cuboid"][0], flat[0], atol=0.05)
        assert np.allclose(np.array(row["location"]) * 10, item["pose"]["tvec_mm"], atol=0.01)
        assert len(row["projected_cuboid"]) == 9


@pytest.mark.parametrize("name", FORMATS)
def test_empty_frames_one_class_spaces_and_umlauts(tmp_path: Path, export: Export, name: str) -> None:
    box = make_box("box-1", 0, type_="Kiste  für Äpfel")
    painter = Painter()
    rows = []
    for number in range(6):
        poses = {} if number % 3 == 2 else {"box-1": moving(number)["box-1"]}
        rows.append((label_of(number, poses, (box,)), {"rgb": painter.paint(poses, (box,))["rgb"]}))
    session = tmp_path / "Sitzung mit Leerzeichen" / "über"
    write_session(session, rows, (box,))
    told = export(name, session, "--classes", "type", "--split", "none", out=tmp_path / "out")
    assert told["classes"] == {"Kiste für Äpfel": 4}
    assert told["samples"] == {"train": 6}
    assert told["checks"]["wrong"] == []
    without = export(name, session, "--classes", "type", "--split", "none", "--no-background", out=tmp_path / "out")
    assert without["samples"] == {"train": 4}
    assert without["files"]["removed"] > 0


@pytest.mark.parametrize(
    ("name", "folder"), [("..", "__"), (".", "_"), ("../../x", ".._.._x"), ("für Äpfel", "für_Äpfel"), ("a.b", "a.b")]
)
def test_a_class_never_leads_out_of_its_folder(name: str, folder: str) -> None:
    assert folders([name]) == {name: folder}


def test_no_two_classes_share_a_folder() -> None:
    assert list(folders(["a_b", "a/b", "a b", "a_b-2"]).values()) == ["a_b", "a_b-2", "a_b-3", "a_b-2-2"]


@pytest.mark.long
@pytest.mark.parametrize("name", FORMATS)
def test_the_papers_449_samples(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, export: Export, name: str
) -> None:
    folder = tmp_path_factory.getbasetemp() / "449"
    if not folder.exists():
        write_session(folder, samples(449))
    told = export(name, folder, out=tmp_path / "out")
    assert told["checks"]["wrong"] == []
    assert sum(told["samples"].values()) + told["left_out"].get("neighbour", 0) == 449


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_10_000_samples(session60: Path, tmp_path: Path, export: Export) -> None:
    """One picture serves all, so no split is honest; the labels are each one's own."""
    picture = cv2.imread(str(min((session60 / "rgb").iterdir())))
    session = tmp_path / "many"
    write_session(session, ((label_of(number, moving(number)), {"rgb": picture}) for number in range(10_000)))
    refused = export("yolo", session, "--split", "block", out=tmp_path / "out", code=3)
    assert "no validation set" in refused["error"]["message"]
    told = export("yolo", session, "--split", "none", out=tmp_path / "out")
    assert told["samples"] == {"train": 10_000}
    assert told["checks"]["wrong"] == []
    assert len(os.listdir(tmp_path / "out" / "images" / "train")) == told["samples"]["train"]  # noqa: PTH208
