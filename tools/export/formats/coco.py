"""COCO: instances with masks and the eight corners as keypoints, one JSON a part.

``images/PART/STEM.png``, ``annotations/instances_PART.json``. Boxes and outlines count from the picture's upper left
edge (a pixel's centre is at 0.5), keypoints from the pixel's centre, as COCO's own data do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from common.geometry import CORNER_NAMES, EDGES
from common.labels import Window
from tools.export.formats.parts import Array, json_text, picture_file, read_json
from tools.export.masks import covering, runs, visible_mask
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file

_DIGITS = 3


class Coco:
    """COCO instances and keypoints."""

    traits: ClassVar[Traits] = Traits(default_classes="type")

    def shot(self, shot: Shot, export: Export) -> Written:
        """The picture; its annotations are told to the index."""
        told = [_annotation(target, shot, before) for target, before in zip(shot.targets, covering(shot), strict=True)]
        return Written((picture_file(shot, f"images/{shot.split}/{_file(shot)}"),), told)

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """One file of annotations a part. Ids begin with 1: COCOeval takes an id of 0 for none."""
        categories = [
            {
                "id": number,
                "name": name,
                "supercategory": "object",
                "keypoints": list(CORNER_NAMES),
                "skeleton": [[a + 1, b + 1] for a, b in EDGES],
            }
            for number, name in enumerate(export.classes, 1)
        ]
        files = []
        for part in export.splits:
            images: list[dict[str, Any]] = []
            annotations: list[dict[str, Any]] = []
            for shot in export.of(part):
                size = {"width": shot.camera.width, "height": shot.camera.height}
                images.append({"id": len(images) + 1, "file_name": _file(shot), **size})
                for plain in told[shot.number]:
                    ids = {"id": len(annotations) + 1, "image_id": len(images)}
                    annotations.append(ids | plain)
            document = {
                "info": {"description": f"Exported by tagmill, part {part}", "version": "1"},
                "licenses": [],
                "images": images,
                "annotations": annotations,
                "categories": categories,
            }
            files.append(text_file(f"annotations/instances_{part}.json", json_text(document)))
        return files

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """From the JSON files."""
        for part in export.splits:
            plain = read_json(folder / "annotations" / f"instances_{part}.json")
            names = {row["id"]: row["name"] for row in plain["categories"]}
            rows: dict[str, list[ReadTarget]] = {row["file_name"]: [] for row in plain["images"]}
            files = {row["id"]: row["file_name"] for row in plain["images"]}
            for row in plain["annotations"]:
                x, y, width, height = row["bbox"]
                window = np.array([x, y, x + width, y + height]) - 0.5
                points = np.array(row["keypoints"], dtype=np.float64).reshape(-1, 3)
                points[points[:, 2] == 0] = np.nan
                found = ReadTarget(names[row["category_id"]], window=window, points=points[:, :2])
                rows[files[row["image_id"]]].append(found)
            for shot in export.of(part):
                yield shot, rows.get(_file(shot), [])

    def notes(self, export: Export) -> list[str]:
        """What a user of COCOeval for keypoints has to set."""
        return ["keypoint evaluation with 8 points needs COCOeval.params.kpt_oks_sigmas set to 8 values"]


def _file(shot: Shot) -> str:
    return f"{shot.stem}.{shot.change.extension}"


def _annotation(target: Target, shot: Shot, before: list[Target]) -> dict[str, Any]:
    if before:
        mask = visible_mask(shot, target, before)
        segmentation: Any = {"size": [shot.camera.height, shot.camera.width], "counts": runs(mask)}
        area = float(mask.sum())
    else:
        corner = target.outline + 0.5
        segmentation = [[round(float(value), _DIGITS) for value in corner.ravel()]]
        area = _area(corner)
    keypoints: list[float] = []
    for (x, y), state in zip(target.corners, target.states, strict=True):
        keypoints += [0, 0, 0] if state == 0 else [round(float(x), _DIGITS), round(float(y), _DIGITS), state]
    return {
        "category_id": target.class_id + 1,
        "bbox": _box(target.window),
        "area": round(area, _DIGITS),
        "iscrowd": 0,
        "segmentation": segmentation,
        "keypoints": keypoints,
        "num_keypoints": sum(state > 0 for state in target.states),
    }


def _box(window: Window) -> list[float]:
    x, y = window.x_min + 0.5, window.y_min + 0.5
    return [round(value, _DIGITS) for value in (x, y, window.x_max - window.x_min, window.y_max - window.y_min)]


def _area(polygon: Array) -> float:
    """Of a polygon (N, 2). Method: the shoelace formula."""
    x, y = polygon.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
