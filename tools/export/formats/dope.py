"""DOPE / NDDS: a JSON file beside each undistorted picture.

Lengths are centimetres. ``projected_cuboid`` is in NVIDIA's order (front top right, front top left, front bottom left,
front bottom right, the same four behind), the centroid last. The object frame is tagmill's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from common.geometry import CORNER_NAMES
from tools.export.formats.parts import Array, json_text, picture_file, read_json
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file

_ROWS = ("top_right", "top_left", "bottom_left", "bottom_right")
ORDER = tuple(CORNER_NAMES.index(f"{face}_{row}") for face in ("front", "back") for row in _ROWS)
_DIGITS = 4


class Dope:
    """DOPE's training data."""

    traits: ClassVar[Traits] = Traits(default_classes="type", whole=True, undistorted=True)

    def shot(self, shot: Shot, export: Export) -> Written:
        """Picture and annotation."""
        plain = {
            "camera_data": {"width": shot.camera.width, "height": shot.camera.height, "intrinsics": _intrinsics(shot)},
            "objects": [_object(target, shot) for target in shot.targets],
        }
        return Written(
            (
                picture_file(shot, f"{shot.split}/{shot.stem}.{shot.change.extension}"),
                text_file(f"{shot.split}/{shot.stem}.json", json_text(plain)),
            )
        )

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """``_object_settings.json`` and ``_camera_settings.json`` in each part."""
        sizes: dict[str, list[float]] = {}
        for shot in export.shots:
            for target in shot.targets:
                sizes.setdefault(target.class_name, [value / 10 for value in target.box.size_mm])
        objects = {
            "exported_object_classes": list(sizes),
            "exported_objects": [
                {"class": name, "segmentation_class_id": number, "cuboid_dimensions": size}
                for number, (name, size) in enumerate(sizes.items(), 1)
            ],
        }
        files = []
        for part in export.splits:
            first = export.of(part)[0]
            size = {"width": first.camera.width, "height": first.camera.height}
            cameras = {
                "camera_settings": [
                    {"name": "camera", "intrinsic_settings": _intrinsics(first), "captured_image_size": size}
                ]
            }
            files.append(text_file(f"{part}/_object_settings.json", json_text(objects)))
            files.append(text_file(f"{part}/_camera_settings.json", json_text(cameras)))
        return files

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """The projected cuboids."""
        for shot in export.shots:
            plain = read_json(folder / shot.split / f"{shot.stem}.json")
            found = []
            for row in plain["objects"]:
                points = np.full((len(ORDER), 2), np.nan)
                points[list(ORDER)] = np.array(row["projected_cuboid"])[:-1]
                found.append(ReadTarget(row["class"], points=points))
            yield shot, found

    def notes(self, export: Export) -> list[str]:
        """What could not be verified."""
        return ["DOPE's frame of the object is not documented; location and quaternion are of tagmill's object frame"]


def _intrinsics(shot: Shot) -> dict[str, float]:
    k = shot.camera.matrix
    return {"fx": float(k[0, 0]), "fy": float(k[1, 1]), "cx": float(k[0, 2]), "cy": float(k[1, 2]), "s": 0.0}


def _object(target: Target, shot: Shot) -> dict[str, Any]:
    centre = shot.camera.project(target.pose.translation)[0][0]
    points = np.vstack([target.corners[list(ORDER)], centre])
    window = target.window
    return {
        "class": target.class_name,
        "name": target.item.name,
        "visibility": round(max((face.visible_share for face in target.item.faces), default=1.0), _DIGITS),
        "location": [round(float(value) / 10, _DIGITS) for value in target.pose.translation],
        "quaternion_xyzw": quaternion(target.pose.rotation),
        "projected_cuboid": [[round(float(x), _DIGITS), round(float(y), _DIGITS)] for x, y in points],
        "projected_cuboid_centroid": [round(float(value), _DIGITS) for value in centre],
        "bounding_box": {"top_left": [window.y_min, window.x_min], "bottom_right": [window.y_max, window.x_max]},
    }


def quaternion(rotation: Array) -> list[float]:
    """x y z w of a rotation (3, 3), w >= 0. Method: the eigenvector of Bar-Itzhack's matrix (2000, eq. 8)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    vector = np.linalg.eigh(matrix)[1][:, -1]
    return [float(value) for value in (vector if vector[3] >= 0 else -vector)]
