"""Detection with cv2.aruco (4.14 and 5.0)."""

from __future__ import annotations

import cv2
import numpy as np

from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey
from services.detect.markers.quads import Corners, area, as_quad, check, merged

DOUBLED_MAX_PIXELS = 4_000_000
"""A larger picture isn't doubled by the thorough search: its small markers have pixels enough."""
MIN_SIDE_PX = 16
"""cv2's adaptive threshold needs a picture of at least this size."""


def parameters() -> cv2.aruco.DetectorParameters:
    """The search's parameters; where they differ from cv2's defaults, measured by ``tagmill bench detect``.

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
        check(grey)
        if min(grey.shape) < MIN_SIDE_PX:
            return []
        found = merged(self._search(grey, 1))
        if self.thorough and grey.size <= DOUBLED_MAX_PIXELS:
            doubled = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            found = merged(found + self._search(np.asarray(doubled, dtype=np.uint8), 2))
        return [DetectedMarker(id=marker, corners=as_quad(corners), kind="subpix") for marker, corners in found]

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
        return sorted(found, key=lambda one: -area(one[1]))
