from __future__ import annotations

import json

import pytest

from tools.evaluate import pose
from tools.evaluate.pose import CAMERAS, MARKERS_MM, PAPER, Exactness, table_1


def test_the_large_marker_at_the_large_size_is_exact(monkeypatch):
    monkeypatch.setattr(pose, "CAMERAS", CAMERAS[1:])
    monkeypatch.setattr(pose, "MARKERS_MM", MARKERS_MM[2:])
    counted = []
    (row,) = table_1(1, 4, lambda: counted.append(1))
    assert len(counted) == row.frames == 4
    assert (row.labelled, row.ambiguous, row.paper) == (4, 0, "+")
    assert row.corner_mean_px < 1.0
    assert row.corner_mean_px <= row.corner_p95_px
    assert row.iou_p5 > 0.98
    assert row.iou_p5 <= row.iou_mean <= 1.0


def test_the_paper_has_a_mark_for_each_row():
    assert set(PAPER) == {(width, round(mm)) for width, _, _ in CAMERAS for mm in MARKERS_MM}


def test_a_row_without_labels_is_null_in_json():
    nan = float("nan")
    row = Exactness(640, 480, 15.0, 10, 0, 0, nan, nan, nan, nan, nan, nan)
    assert row.plain()["iou_mean"] is None
    json.dumps(row.plain(), allow_nan=False)
    assert row.cells().count("-") == 6  # five figures and the paper's own mark


def test_both_cameras_see_the_same_height():
    fields = [height / focal for _, height, focal in CAMERAS]
    assert fields[0] == pytest.approx(fields[1])
