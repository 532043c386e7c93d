"""Candidates: dark quadrilaterals on brighter ground, at one scale of a picture.

A pixel is dark where it lies below a share ``fraction`` of the way from the least to the greatest level of
its neighbourhood, tiles of 4 x 4 pixels and their eight neighbours (tile extrema after E. Olson, J. Wang,
IROS 2016). Tiles of little contrast hold no dark pixels at all, and how much contrast it takes follows from
the picture: noise and fine texture would cost time, not yield markers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from services.detect.markers.base import Grey

Array = NDArray[np.float64]

TILE_PX = 4
LEAST_CONTRAST = 16
"""Grey levels that a tile needs at least; up to a level's ``contrast`` more in a busy picture."""
BUSY = 0.2
"""The share of a picture's tiles that may be looked at before more contrast than the least is asked for."""
LEAST_SIDE_PX = 9
LEAST_POINTS = 10
"""A contour's runs, two a row: what spans fewer rows is no marker."""
THINNEST = 6.0
"""Length to width of a bounding box."""
SOLID = 0.75
"""A contour's area as a share of its convex hull's."""
LEAST_FILL = 0.12
"""The hull's area as a share of its bounding box's."""
LEAST_SHARE = SOLID * LEAST_FILL
"""A contour's area as a share of its bounding box's; follows from the two, and costs no hull."""
LIKE_HULL = 0.8
"""A quad's area as a share of the hull's that it was made from."""
STRAIGHTNESS = (0.05, 0.03, 0.018, 0.09)
"""Tolerances of the polygon, as shares of the perimeter, in the order in which they are tried."""

_TILE = np.ones((TILE_PX, TILE_PX), dtype=np.uint8)
_NEIGHBOURS = np.ones((3, 3), dtype=np.uint8)


@dataclass(frozen=True)
class Level:
    """One look at the picture: magnified by ``scale`` (1, 1/2, 2), with ``fraction`` as the threshold.

    ``contrast``: the grey levels that a tile may have to have in a busy picture, at most.
    """

    scale: float
    fraction: float
    contrast: int = 40


def find_quads(grey: Grey, level: Level) -> tuple[Array, Array]:
    """Quads (K, 4, 2) px of the unscaled picture, turning clockwise, and how far off (K,) px they may be."""
    if min(grey.shape) * level.scale < 2 * TILE_PX:
        return np.empty((0, 4, 2)), np.empty(0)
    scaled = grey if level.scale == 1 else _scaled(grey, level.scale)
    quads = _quads(_contours(dark(scaled, level.fraction, level.contrast)))
    # A pixel's centre moves when a picture is scaled: its corner is what stays.
    quads = (quads + 0.5) / level.scale - 0.5
    turned = signed_areas(quads) < 0
    quads[turned] = quads[turned][:, ::-1]
    return quads, np.full(len(quads), 1.2 / level.scale)


def dark(grey: Grey, fraction: float, contrast: int) -> Grey:
    """255 where a picture (H, W) is dark against its neighbourhood, else 0; ``contrast`` as in ``Level``."""
    height, width = grey.shape
    high = cv2.dilate(cv2.dilate(grey, _TILE, anchor=(0, 0))[::TILE_PX, ::TILE_PX], _NEIGHBOURS)
    low = cv2.erode(cv2.erode(grey, _TILE, anchor=(0, 0))[::TILE_PX, ::TILE_PX], _NEIGHBOURS)
    spread = cv2.subtract(high, low)
    threshold = cv2.addWeighted(high, fraction, low, 1 - fraction, 0)
    threshold[spread < _contrast(np.asarray(spread, dtype=np.uint8), contrast)] = 0
    rows, columns = threshold.shape
    full = cv2.resize(threshold, (columns * TILE_PX, rows * TILE_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.compare(grey, full[:height, :width], cv2.CMP_LT), dtype=np.uint8)


def signed_areas(quads: Array) -> Array:
    """Areas (K,) of quads (K, 4, 2); positive where the corners go clockwise as seen."""
    diagonal, other = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return np.asarray(0.5 * (diagonal[:, 0] * other[:, 1] - diagonal[:, 1] * other[:, 0]))


def _contrast(spread: Grey, most: int) -> int:
    """The least contrast for which no more than a share BUSY of the tiles is looked at, within its limits."""
    counts = cv2.calcHist([spread], [0], None, [256], [0, 256]).ravel()
    at_least = np.cumsum(counts[::-1])[::-1]
    return int(np.clip(np.argmax(at_least <= BUSY * spread.size), LEAST_CONTRAST, most))


def _scaled(grey: Grey, scale: float) -> Grey:
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    size = (int(grey.shape[1] * scale), int(grey.shape[0] * scale))
    # The part that fills whole pixels of the result, lest the scale differ from the one that was asked for.
    whole = grey[: round(size[1] / scale), : round(size[0] / scale)]
    return np.asarray(cv2.resize(whole, size, interpolation=how), dtype=np.uint8)


def _contours(mask: Grey) -> Sequence[NDArray[Any]]:
    """Points (N, 1, 2) of each border between 255 and 0, a row's runs at a time."""
    found: Sequence[NDArray[Any]] = cv2.findContoursLinkRuns(mask)[0]
    return found


def _quads(contours: Sequence[NDArray[Any]]) -> Array:
    """The quads (K, 4, 2) among contours of 255 in a mask: outer, solid, and as a hull of four corners."""
    corners, areas = [], []
    for contour in contours:
        if len(contour) < LEAST_POINTS:
            continue
        _, _, width, height = cv2.boundingRect(contour)
        long, short = (width, height) if width > height else (height, width)
        if long < LEAST_SIDE_PX or long > THINNEST * short:
            continue
        area = cv2.contourArea(contour, oriented=True)
        if area <= LEAST_SHARE * width * height:  # negative: the border of a hole
            continue
        hull = cv2.convexHull(contour)
        around = cv2.contourArea(hull)
        if area < SOLID * around or around < LEAST_FILL * width * height:
            continue
        quad = _four_corners(hull, around)
        if quad is not None:
            corners.append(quad)
            areas.append(around)
    quads = np.array(corners, dtype=np.float64).reshape(-1, 4, 2)
    middles = quads.mean(axis=1, keepdims=True)
    # A contour runs through the centres of its outermost pixels, half a pixel inside the edge.
    return np.asarray((quads - middles) * (1 + 1 / np.sqrt(areas))[:, None, None] + middles)


def _four_corners(hull: NDArray[Any], area: float) -> NDArray[Any] | None:
    perimeter = cv2.arcLength(hull, closed=True)
    for share in STRAIGHTNESS:
        polygon = cv2.approxPolyDP(hull, share * perimeter, closed=True)
        if len(polygon) == 4 and cv2.contourArea(polygon) >= LIKE_HULL * area:
            return polygon
    return None
