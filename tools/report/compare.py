"""Labels against ground truth: window IoU, corner error, distance error. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.labels import ObjectLabel, Window
from common.messages import TrueObject


@dataclass(frozen=True)
class Difference:
    """One object of one sample against the truth. Pixels and millimetres."""

    object: str
    iou: float
    corner_px: float
    distance_mm: float
    true_distance_mm: float
    corners_px: tuple[float, ...] = ()
    """The error of each corner that has a projection."""


def iou(first: Window, second: Window) -> float:
    """Intersection over union of two windows, 0 to 1."""
    width = min(first.x_max, second.x_max) - max(first.x_min, second.x_min)
    height = min(first.y_max, second.y_max) - max(first.y_min, second.y_min)
    if width <= 0 or height <= 0:
        return 0.0
    common = width * height
    return common / (_area(first) + _area(second) - common)


def _area(window: Window) -> float:
    return (window.x_max - window.x_min) * (window.y_max - window.y_min)


def compare(objects: Sequence[ObjectLabel], truth: Sequence[TrueObject]) -> list[Difference]:
    """Each labelled object that the truth knows: unclipped windows, mean distance of the corners, |origin|."""
    by_name = {item.name: item for item in truth}
    differences = []
    for item in objects:
        true = by_name.get(item.name)
        if true is None:
            continue
        pairs = [
            ((corner.x, corner.y), at)
            for corner, at in zip(item.corners, true.corners, strict=True)
            if corner.x is not None and corner.y is not None
        ]
        errors = [float(np.hypot(x - u, y - v)) for (x, y), (u, v) in pairs]
        differences.append(
            Difference(
                item.name,
                iou(item.window_unclipped, true.window),
                float(np.mean(errors)) if errors else float("inf"),
                item.distance_mm - true.distance_mm,
                true.distance_mm,
                tuple(errors),
            )
        )
    return differences
