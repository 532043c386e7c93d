"""Quads of markers: what every backend needs to hand them out in tagmill's convention, each marker once."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import Quad
from services.detect.markers.base import Grey

Corners = NDArray[np.float64]

ALIKE = 0.25
"""Two quads are contours of one marker only if the smaller has this share of the larger one's area."""


def check(grey: Grey) -> None:
    """Raises ValueError for anything but a grey picture (H, W) uint8."""
    if grey.ndim != 2 or grey.dtype != np.uint8:
        raise ValueError(f"expected a grey picture (H, W) uint8, got {grey.shape} {grey.dtype}")


def merged(found: list[tuple[int, Corners]]) -> list[tuple[int, Corners]]:
    """Each physical marker once: of two quads that cover the same paper the earlier stays."""
    if len(found) < 2:
        return found
    quads = np.array([corners for _, corners in found])
    middles = quads.mean(axis=1)
    reach = np.abs(quads - middles[:, None]).max(axis=(1, 2))
    apart = np.abs(middles[:, None] - middles).max(axis=2)
    near = apart < np.maximum(reach[:, None], reach)
    kept: list[int] = []
    for one in range(len(found)):
        if not any(same_place(quads[one], quads[other]) for other in kept if near[one, other]):
            kept.append(one)
    return [found[one] for one in kept]


def same_place(one: Corners, other: Corners) -> bool:
    """Whether two quads are contours of the same marker: alike in size, each holding the other's centre."""
    areas = sorted((area(one), area(other)))
    if areas[0] < ALIKE * areas[1]:
        return False
    return _holds(one, other.mean(axis=0)) and _holds(other, one.mean(axis=0))


def area(corners: Corners) -> float:
    """The area of a quad (4, 2), square px."""
    return float(cv2.contourArea(corners.astype(np.float32)))


def as_quad(corners: Corners) -> Quad:
    """Corners (4, 2) as a message's quad."""
    top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in corners)
    return top_left, top_right, bottom_right, bottom_left


def _holds(quad: Corners, point: Corners) -> bool:
    inside: float = cv2.pointPolygonTest(quad.astype(np.float32), (float(point[0]), float(point[1])), measureDist=False)
    return inside >= 0
