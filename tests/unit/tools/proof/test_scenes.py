from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from tools.proof.scenes import BARE, DEPTH, HEIGHT, MARKED, WIDTH, Room, class_names, render_test, render_training


def test_the_twins_differ_by_the_markers_alone(tmp_path: Path) -> None:
    room = Room(tmp_path, 1)
    render_training([room], 1, workers=1)
    marked, bare = (cv2.imread(str(tmp_path / name / room.picture(0))) for name in (MARKED, BARE))
    depth = cv2.imread(str(tmp_path / DEPTH / room.picture(0)), cv2.IMREAD_UNCHANGED)
    assert marked is not None
    assert bare is not None
    assert depth is not None
    assert marked.shape == (HEIGHT, WIDTH, 3)
    assert depth.dtype == np.uint16
    changed = (marked != bare).any(axis=2).mean()
    assert 0.001 < changed < 0.1


def test_the_held_out_pictures_show_each_side_as_often_and_their_windows_are_in_them(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    render_test([Room(tmp_path / "test", 2)], 1, path, workers=1)
    truth = json.loads(path.read_text())
    assert [kind["name"] for kind in truth["categories"]] == list(class_names()) == ["front", "back", "left", "right"]
    assert sorted(item["category_id"] for item in truth["annotations"]) == [0, 1, 2, 3]
    for image, item in zip(truth["images"], truth["annotations"], strict=True):
        assert Path(image["file_name"]).is_file()
        x, y, wide, high = item["bbox"]
        assert x >= 0
        assert y >= 0
        assert x + wide <= WIDTH
        assert y + high <= HEIGHT
        assert wide > 60
        assert high > 60
