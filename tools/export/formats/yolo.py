"""YOLO: detection (Darknet and Ultralytics), pose, oriented boxes, segments.

``images/PART/STEM.png`` with ``labels/PART/STEM.txt`` (empty for a background picture), ``data.yaml`` for Ultralytics;
for Darknet ``obj.data``, ``obj.names``, ``train.txt`` ... with paths relative to the export, so that no parent folder's
name can lead it astray: start Darknet in that folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import yaml

from common.errors import DatasetError
from common.geometry import CORNER_NAMES
from tools.export.formats.parts import Array, as_array, number, picture_file, pixels_of, read_text, shares, unit
from tools.export.masks import visible_outlines
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file

_LABELS = "labels"
"""The folder that mirrors ``images``."""


class Yolo:
    """Detection: ``class x_centre y_centre width height``, shares of the picture."""

    traits: ClassVar[Traits] = Traits(default_classes="side")

    def shot(self, shot: Shot, export: Export) -> Written:
        """Picture and label."""
        extension = shot.change.extension
        rows = "".join(f"{row}\n" for row in self._rows(shot))
        return Written(
            (
                picture_file(shot, f"images/{shot.split}/{shot.stem}.{extension}"),
                text_file(f"{_LABELS}/{shot.split}/{shot.stem}.txt", rows),
            )
        )

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """``data.yaml``, and Darknet's lists."""
        data: dict[str, Any] = {f"{part}": f"images/{part}" for part in export.splits}
        data["names"] = dict(enumerate(export.classes))
        data |= self._more(export)
        about = f"# Exported by tagmill; what and how: tagmill-export.json\n# {len(export.shots)} pictures\n"
        text = about + yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
        return [text_file("data.yaml", text), *self._darknet(export)]

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """From the label files and ``data.yaml``."""
        names = yaml.safe_load(read_text(folder / "data.yaml"))["names"]
        for shot in export.shots:
            path = folder / _LABELS / shot.split / f"{shot.stem}.txt"
            found = []
            for line in read_text(path).splitlines():
                values = line.split()
                try:
                    name, numbers = names[int(values[0])], np.array(values[1:], dtype=np.float64)
                    self._require(numbers)
                except (ValueError, IndexError, KeyError) as error:
                    raise DatasetError(f"{path}: '{line}' is no row of {export.name}: {error}") from error
                found.append(self._read_row(name, numbers, shot))
            yield shot, found

    def notes(self, export: Export) -> list[str]:
        """That Ultralytics wants a validation set."""
        if "val" in export.splits:
            return []
        return ["there is no validation set, which Ultralytics asks for: data.yaml has no 'val'"]

    def _rows(self, shot: Shot) -> list[str]:
        return [f"{target.class_id} {_box(target, shot)}" for target in shot.targets]

    def _more(self, export: Export) -> dict[str, Any]:
        return {}

    def _darknet(self, export: Export) -> list[OutFile]:
        lists = {"train": "train.txt", "val": "valid.txt", "test": "test.txt"}
        files = [
            text_file(
                lists[part],
                "".join(f"images/{part}/{shot.stem}.{shot.change.extension}\n" for shot in export.of(part)),
            )
            for part in export.splits
        ]
        about = f"classes = {len(export.classes)}\ntrain = train.txt\n"
        about += f"valid = {lists['val' if 'val' in export.splits else 'train']}\nnames = obj.names\nbackup = backup\n"
        names = "".join(f"{name}\n" for name in export.classes)
        return [*files, text_file("obj.names", names), text_file("obj.data", about)]

    def _require(self, numbers: Array) -> None:
        """Raise ValueError for numbers that the loader would refuse."""
        if len(numbers) != 4:
            raise ValueError(f"{len(numbers) + 1} columns instead of 5")
        _in_unit(numbers)

    def _read_row(self, name: str, numbers: Array, shot: Shot) -> ReadTarget:
        return ReadTarget(name, window=_window(numbers, shot))


class YoloPose(Yolo):
    """Pose: the box, then ``x y v`` for each of the eight corners; ``0 0 0`` for one outside the picture."""

    traits: ClassVar[Traits] = Traits(default_classes="type")

    def _rows(self, shot: Shot) -> list[str]:
        return [f"{target.class_id} {_box(target, shot)} {_keypoints(target, shot)}" for target in shot.targets]

    def _more(self, export: Export) -> dict[str, Any]:
        names = list(CORNER_NAMES)
        return {"kpt_shape": [len(names), 3], "kpt_names": dict.fromkeys(range(len(export.classes)), names)}

    def _darknet(self, export: Export) -> list[OutFile]:
        return []

    def _require(self, numbers: Array) -> None:
        if len(numbers) != 4 + 3 * len(CORNER_NAMES):
            raise ValueError(f"{len(numbers) + 1} columns instead of {5 + 3 * len(CORNER_NAMES)}")
        _in_unit(np.concatenate([numbers[:4], numbers[4:].reshape(-1, 3)[:, :2].ravel()]))

    def _read_row(self, name: str, numbers: Array, shot: Shot) -> ReadTarget:
        points = numbers[4:].reshape(-1, 3)
        pixels = pixels_of(points[:, :2], shot)
        pixels[points[:, 2] == 0] = np.nan
        return ReadTarget(name, window=_window(numbers[:4], shot), points=pixels)


class YoloObb(Yolo):
    """Oriented boxes: the four corners of the smallest rectangle around what is in the picture."""

    def _rows(self, shot: Shot) -> list[str]:
        return [f"{target.class_id} {_points(_oriented(target, shot), shot)}" for target in shot.targets]

    def _darknet(self, export: Export) -> list[OutFile]:
        return []

    def _require(self, numbers: Array) -> None:
        if len(numbers) != 8:
            raise ValueError(f"{len(numbers) + 1} columns instead of 9")
        _in_unit(numbers)

    def _read_row(self, name: str, numbers: Array, shot: Shot) -> ReadTarget:
        return ReadTarget(name, outline=pixels_of(numbers.reshape(-1, 2), shot))


class YoloSegment(Yolo):
    """Segments: the outline of what is visible. An object behind another one keeps its largest visible piece."""

    def _rows(self, shot: Shot) -> list[str]:
        pairs = zip(shot.targets, visible_outlines(shot), strict=True)
        return [
            f"{target.class_id} {_points(outline if len(outline) >= 3 else target.outline, shot)}"
            for target, outline in pairs
        ]

    def _darknet(self, export: Export) -> list[OutFile]:
        return []

    def _require(self, numbers: Array) -> None:
        if len(numbers) < 6 or len(numbers) % 2:
            raise ValueError(f"{len(numbers)} numbers are no outline")
        _in_unit(numbers)

    def _read_row(self, name: str, numbers: Array, shot: Shot) -> ReadTarget:
        return ReadTarget(name, outline=pixels_of(numbers.reshape(-1, 2), shot))


def _box(target: Target, shot: Shot) -> str:
    x0, y0, x1, y1 = unit(target.window, shot)
    return " ".join(number(value) for value in ((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0))


def _window(numbers: Array, shot: Shot) -> Array:
    centre, half = numbers[:2], numbers[2:] / 2
    return pixels_of(np.stack([centre - half, centre + half]), shot).ravel()


def _keypoints(target: Target, shot: Shot) -> str:
    parts = []
    for point, state in zip(shares(target.corners, shot), target.states, strict=True):
        parts.append("0 0 0" if state == 0 else f"{number(point[0])} {number(point[1])} {state}")
    return " ".join(parts)


def _points(pixels: Array, shot: Shot) -> str:
    return " ".join(number(value) for value in shares(pixels, shot).clip(0.0, 1.0).ravel())


def _oriented(target: Target, shot: Shot) -> Array:
    """The smallest rectangle (4, 2) around the outline; the window where that would leave the picture."""
    corners = np.asarray(cv2.boxPoints(cv2.minAreaRect(target.outline.astype(np.float32))), dtype=np.float64)
    inside = shares(corners, shot)
    if (inside >= -1e-6).all() and (inside <= 1 + 1e-6).all():
        return corners
    x0, y0, x1, y1 = as_array(target.window)
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _in_unit(numbers: Array) -> None:
    if not np.isfinite(numbers).all() or (numbers < 0).any() or (numbers > 1).any():
        raise ValueError("a coordinate is not within 0 and 1")
