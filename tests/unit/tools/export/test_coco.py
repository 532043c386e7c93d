"""COCO: pycocotools takes it, masks are where the objects are."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.tools.export.conftest import Export

coco = pytest.importorskip("pycocotools.coco")


def test_pycocotools_decodes_every_mask_and_gives_the_truth_1(session60: Path, tmp_path: Path, export: Export) -> None:
    told = export("coco", session60, out=tmp_path / "out")
    assert told["checks"]["wrong"] == []
    assert any("AP 1.0" in line for line in told["checks"]["right"])
    assert told["checks"]["reprojection"]["worst_px"] < 0.01


def test_masks_are_what_the_depth_picture_shows(session60: Path, tmp_path: Path, export: Export) -> None:
    export("coco", session60, "--split", "none", out=tmp_path / "out")
    with contextlib.redirect_stdout(io.StringIO()):
        truth = coco.COCO(str(tmp_path / "out" / "annotations" / "instances_train.json"))
    worst, covered = 1.0, 0
    for image in truth.imgs.values():
        depth = cv2.imread(
            str(session60 / "depth" / f"depth_{Path(image['file_name']).stem}.png"), cv2.IMREAD_UNCHANGED
        )
        rows = truth.loadAnns(truth.getAnnIds(imgIds=[image["id"]]))
        masks = [truth.annToMask(row).astype(bool) for row in rows]
        covered += sum(isinstance(row["segmentation"], dict) for row in rows)
        assert np.sum(masks, axis=0).max(initial=0) <= 1 or np.logical_and.reduce(masks).sum() <= 12  # along a seam
        shown = np.logical_or.reduce(masks)
        worst = min(worst, (shown & (depth < 4000)).sum() / (shown | (depth < 4000)).sum())
    assert covered > 3
    assert worst > 0.95


def test_ids_begin_with_1_and_keypoints_count(session60: Path, tmp_path: Path, export: Export) -> None:
    export("coco", session60, out=tmp_path / "out")
    for path in (tmp_path / "out" / "annotations").iterdir():
        plain = json.loads(path.read_text())
        for key in ("images", "annotations", "categories"):
            assert [row["id"] for row in plain[key]] == list(range(1, len(plain[key]) + 1))
        for row in plain["annotations"]:
            points = np.array(row["keypoints"]).reshape(-1, 3)
            assert row["num_keypoints"] == (points[:, 2] > 0).sum()
            assert (points[points[:, 2] == 0] == 0).all()
        assert all(len(row["keypoints"]) == 8 and row["skeleton"] for row in plain["categories"])
