"""How a detector did: the paper's table (correct, wrong, not detected) and pycocotools' mAP50."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.errors import TagmillError

SHOWN_SCORE = 0.25
"""What scores less is not shown to anybody: Darknet's default, hence that of the paper's table."""
SAME_IOU = 0.5
Xywh = Sequence[float]


@dataclass(frozen=True)
class Row:
    """Of a class's pictures, each with one object: how many were named right, wrong, or not found."""

    name: str
    correct: int
    wrong: int
    missed: int

    @property
    def pictures(self) -> int:
        """All of the class."""
        return self.correct + self.wrong + self.missed


@dataclass(frozen=True)
class Score:
    """The paper's table, a row a class; ``map50`` and ``ap50`` by class, 0..1; how many detections hit nothing."""

    rows: tuple[Row, ...]
    map50: float
    ap50: Mapping[str, float]
    false_alarms: int


def score(truth: Path, found: Path) -> Score:
    """Of COCO files: ``truth`` with one object a picture, ``found`` a list of detections."""
    known, detections = json.loads(truth.read_text()), json.loads(found.read_text())
    rows, false_alarms = table(known, detections)
    map50, ap50 = coco_ap50(truth, detections)
    names = {kind["id"]: kind["name"] for kind in known["categories"]}
    return Score(rows, map50, {names[kind]: value for kind, value in ap50.items()}, false_alarms)


def table(truth: Mapping[str, Any], found: Iterable[Mapping[str, Any]]) -> tuple[tuple[Row, ...], int]:
    """Rows in the order of the categories, and the number of shown detections that hit nothing.

    In each picture the best of the shown detections with an IoU of at least ``SAME_IOU`` with the true window counts,
    whatever it is named.
    """
    shown: dict[int, list[Mapping[str, Any]]] = {}
    for detection in found:
        if detection["score"] >= SHOWN_SCORE:
            shown.setdefault(detection["image_id"], []).append(detection)
    counts: Counter[tuple[int, str]] = Counter()
    false_alarms = 0
    for item in truth["annotations"]:
        here = shown.get(item["image_id"], [])
        hits = [detection for detection in here if iou(detection["bbox"], item["bbox"]) >= SAME_IOU]
        false_alarms += len(here) - len(hits)
        best = max(hits, key=lambda detection: float(detection["score"]), default=None)
        verdict = "missed" if best is None else "correct" if best["category_id"] == item["category_id"] else "wrong"
        counts[item["category_id"], verdict] += 1
    rows = tuple(
        Row(kind["name"], *(counts[kind["id"], verdict] for verdict in ("correct", "wrong", "missed")))
        for kind in truth["categories"]
    )
    return rows, false_alarms


def iou(a: Xywh, b: Xywh) -> float:
    """Intersection over union of two windows (x, y, width, height)."""
    wide = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    high = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    both = max(wide, 0.0) * max(high, 0.0)
    return both / max(a[2] * a[3] + b[2] * b[3] - both, 1e-9)


def coco_ap50(truth: Path, found: Sequence[Mapping[str, Any]]) -> tuple[float, dict[int, float]]:
    """mAP at IoU 0.5 and that of each category, by pycocotools; raises TagmillError if it isn't installed."""
    try:
        coco = importlib.import_module("pycocotools.coco")
        evaluation = importlib.import_module("pycocotools.cocoeval")
    except ImportError:
        raise TagmillError("pycocotools is not installed; pip install 'tagmill[check]'") from None
    with contextlib.redirect_stdout(io.StringIO()):
        known = coco.COCO(str(truth))
        if not found:
            return 0.0, dict.fromkeys(known.getCatIds(), 0.0)
        run = evaluation.COCOeval(known, known.loadRes([dict(row) for row in found]), "bbox")
        run.params.iouThrs = run.params.iouThrs[:1]
        run.evaluate()
        run.accumulate()
    # precision: IoU threshold x recall x category x area x most detections; -1 where a category has no object.
    precision = run.eval["precision"][0, :, :, 0, -1]
    by_class = {kind: float(precision[:, at].mean()) for at, kind in enumerate(run.params.catIds)}
    return sum(by_class.values()) / len(by_class), by_class
