"""Detection with cv2.aruco (4.14 and 5.0)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import Quad
from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey

Corners = NDArray[np.float64]

DOUBLED_MAX_PIXELS = 4_000_000
"""A larger picture isn't doubled by the thorough search: its small markers have pixels enough."""
MIN_SIDE_PX = 16
"""cv2's adaptive threshold needs a picture of at least this size."""


def parameters() -> cv2.aruco.DetectorParameters:
    """The search's parameters; where they differ from cv2's defaults, measured by tools/bench/detect_recall.py.

    More samples a cell, and only those from its middle, read small and blurred cells better (nasa_swarmathon:
    41 of 47 instead of 36 at the same price). The defaults stay where a change costs recall
    (polygonalApproxAccuracyRate 0.05 loses 2 of duckietown's 22) or safety (a higher errorCorrectionRate
    invents ids).
    """
    chosen = cv2.aruco.DetectorParameters()
    chosen.perspectiveRemovePixelPerCell = 8
    chosen.perspectiveRemoveIgnoredMarginPerCell = 0.25
    chosen.minMarkerDistanceRate = 0.05
    chosen.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return chosen


class OpenCvDetector:
    """Markers of one family by cv2.aruco, in tagmill's convention.

    ``thorough`` searches the picture doubled as well, which finds small and crowded markers.
    """

    def __init__(self, family: Family, *, thorough: bool = False) -> None:
        self.family = family
        self.thorough = thorough
        self._detector = cv2.aruco.ArucoDetector(family.dictionary, parameters())
        self._order = list(family.own_order)

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8; ``kind`` is ``subpix``. Raises ValueError for another shape."""
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise ValueError(f"expected a grey picture (H, W) uint8, got {grey.shape} {grey.dtype}")
        if min(grey.shape) < MIN_SIDE_PX:
            return []
        found = _merged(self._search(grey, 1))
        if self.thorough and grey.size <= DOUBLED_MAX_PIXELS:
            doubled = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            found = _merged(found + self._search(np.asarray(doubled, dtype=np.uint8), 2))
        return [DetectedMarker(id=marker, corners=_quad(corners), kind="subpix") for marker, corners in found]

    def _search(self, grey: Grey, scale: int) -> list[tuple[int, Corners]]:
        """Ids and corners (4, 2) px of the unscaled picture, own order; larger markers first."""
        quads, ids, _ = self._detector.detectMarkers(grey)
        if ids is None or not len(quads):
            return []
        found = [
            # A pixel's centre moves when a picture is scaled: its corner is what stays.
            (
                int(marker),
                (np.asarray(quad, dtype=np.float64).reshape(4, 2)[self._order] + 0.5) / scale - 0.5,
            )
            for marker, quad in zip(np.asarray(ids).ravel(), quads, strict=True)
        ]
        return sorted(found, key=lambda one: -_area(one[1]))


def _merged(found: list[tuple[int, Corners]]) -> list[tuple[int, Corners]]:
    """Each physical marker once: of two quads that cover the same paper the earlier stays."""
    kept: list[tuple[int, Corners]] = []
    for marker, corners in found:
        if not any(_same_place(corners, other) for _, other in kept):
            kept.append((marker, corners))
    return kept


def _same_place(one: Corners, other: Corners) -> bool:
    """Whether two quads are contours of the same marker: alike in size, each holding the other's centre."""
    areas = sorted((_area(one), _area(other)))
    if areas[0] < 0.25 * areas[1]:
        return False
    return _holds(one, other.mean(axis=0)) and _holds(other, one.mean(axis=0))


def _holds(quad: Corners, point: Corners) -> bool:
    inside: float = cv2.pointPolygonTest(quad.astype(np.float32), (float(point[0]), float(point[1])), measureDist=False)
    return inside >= 0


def _area(corners: Corners) -> float:
    return float(cv2.contourArea(corners.astype(np.float32)))


def _quad(corners: Corners) -> Quad:
    top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in corners)
    return top_left, top_right, bottom_right, bottom_left
