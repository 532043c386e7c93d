"""Detection with the optional package locus-tag."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from common.errors import ConfigError
from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey
from services.detect.markers.quads import as_quad, check

FAMILIES = {
    "apriltag_16h5": "AprilTag16h5",
    "apriltag_36h11": "AprilTag36h11",
    "4x4_50": "ArUco4x4_50",
    "4x4_100": "ArUco4x4_100",
    "6x6_250": "ArUco6x6_250",
    "aruco_mip_36h12": "ArUcoMip36h12",
}
"""Families that the package has, and its names for them."""
PROFILE: Final = "grid"
"""Of its profiles the one that finds most on real pictures (``tagmill bench detect``)."""


class LocusDetector:
    """Markers of one family by locus-tag; ``thorough`` changes nothing, it has no slower search that finds more."""

    def __init__(self, family: Family, *, thorough: bool = False) -> None:
        del thorough
        self.family = family
        self._library = _open(family)
        # Its corners stand in cv2's order, AprilTag families turned as cv2's are.
        self._order = list(family.own_order)

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8; ``kind`` is ``subpix``. Raises ValueError for another shape."""
        check(grey)
        found = self._library.detect(np.ascontiguousarray(grey))
        return [
            # Its first pixel's centre is (0.5, 0.5).
            DetectedMarker(
                id=int(marker), corners=as_quad(np.asarray(corners, np.float64)[self._order] - 0.5), kind="subpix"
            )
            for marker, corners in zip(found.ids, found.corners, strict=True)
        ]


def _open(family: Family) -> Any:
    name = FAMILIES.get(family.name)
    if name is None:
        raise ConfigError(
            f"the detector 'locus' knows the families {', '.join(FAMILIES)}, not {family.name}; "
            "set markers.detector to auto or opencv"
        )
    try:
        import locus
    except ImportError as error:
        raise ConfigError(
            "markers.detector is 'locus', but locus-tag isn't installed: pip install 'tagmill[locus]'"
        ) from error
    return locus.Detector(profile=PROFILE, families=[getattr(locus.TagFamily, name)])
