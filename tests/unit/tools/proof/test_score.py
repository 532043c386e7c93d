from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tools.proof.score import Row, Score, coco_ap50, iou, score, table
from tools.proof.show import judge

NAMES = ("front", "back")


def truth(*kinds: int) -> dict[str, Any]:
    """One object of 100 x 80 px a picture."""
    return {
        "info": {},
        "images": [{"id": at, "file_name": f"{at}.png", "width": 640, "height": 480} for at, _ in enumerate(kinds, 1)],
        "categories": [{"id": at, "name": name} for at, name in enumerate(NAMES)],
        "annotations": [
            {"id": at, "image_id": at, "category_id": kind, "bbox": [50, 60, 100, 80], "area": 8000, "iscrowd": 0}
            for at, kind in enumerate(kinds, 1)
        ],
    }


def detection(image: int, kind: int, score: float, moved: float = 0.0) -> dict[str, Any]:
    return {"image_id": image, "category_id": kind, "bbox": [50 + moved, 60, 100, 80], "score": score}


def test_windows_overlap_as_computed_by_hand() -> None:
    assert iou([0, 0, 10, 10], [5, 0, 10, 10]) == pytest.approx(50 / 150)
    assert iou([0, 0, 10, 10], [10, 0, 10, 10]) == 0.0
    assert iou([0, 0, 10, 10], [20, 20, 10, 10]) == 0.0
    assert iou([3, 4, 10, 10], [3, 4, 10, 10]) == pytest.approx(1.0)


def test_a_picture_counts_as_its_best_hit_is_named() -> None:
    found = [detection(1, 0, 0.9), detection(1, 1, 0.5), detection(2, 0, 0.4), detection(2, 1, 0.3)]
    rows, false_alarms = table(truth(0, 1), found)
    assert rows == (Row("front", 1, 0, 0), Row("back", 0, 1, 0))
    assert false_alarms == 0


def test_what_is_not_sure_enough_or_beside_the_object_finds_nothing() -> None:
    found = [detection(1, 0, 0.24), detection(2, 1, 0.9, moved=60.0)]
    rows, false_alarms = table(truth(0, 1, 1), found)
    assert rows == (Row("front", 0, 0, 1), Row("back", 0, 0, 2))
    assert false_alarms == 1
    assert [row.pictures for row in rows] == [1, 2]


def test_the_average_precision_is_that_of_pycocotools(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(truth(0, 0, 1, 1)))
    perfect = [detection(1, 0, 0.9), detection(2, 0, 0.8), detection(3, 1, 0.9), detection(4, 1, 0.8)]
    map50, by_class = coco_ap50(path, perfect)
    assert map50 == pytest.approx(1.0)
    assert by_class == pytest.approx({0: 1.0, 1: 1.0})
    # Half of the recall at full precision: 51 of the 101 points of recall.
    map50, by_class = coco_ap50(path, perfect[:3])
    assert by_class == pytest.approx({0: 1.0, 1: 51 / 101})
    assert map50 == pytest.approx((1 + 51 / 101) / 2)


def test_nothing_found_is_a_score_of_nothing(tmp_path: Path) -> None:
    known, found = tmp_path / "truth.json", tmp_path / "found.json"
    known.write_text(json.dumps(truth(0, 1)))
    found.write_text("[]")
    assert score(known, found) == Score(
        (Row("front", 0, 0, 1), Row("back", 0, 0, 1)), 0.0, {"front": 0.0, "back": 0.0}, 0
    )


@pytest.mark.parametrize(
    ("free", "erased", "raw", "reached"),
    [(0.8, 0.73, 0.5, True), (0.8, 0.71, 0.5, False), (0.8, 0.8, 0.8, False), (0.0, 0.0, 0.0, False)],
)
def test_erasing_works_if_it_is_nearly_as_good_as_no_marker_and_better_than_one(
    free: float, erased: float, raw: float, reached: bool
) -> None:
    scores = {
        name: Score((), value, {}, 0) for name, value in (("marker-free", free), ("erased", erased), ("raw", raw))
    }
    assert judge(scores).reached == reached
