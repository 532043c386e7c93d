"""Who takes part in `bench detect`: tagmill's detectors, cv2's three corner methods, AprilTag 3 and locus."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.markers import Family
from services.detect.markers import MarkerDetector, open_detector
from services.detect.markers.apriltag import AprilTagDetector
from services.detect.markers.pattern import FAST, THOROUGH, PatternDetector

Grey = NDArray[np.uint8]
Found = list[tuple[int, NDArray[np.float64]]]
Search = Callable[[Grey, Family], Found | None]
"""Ids and own corners (4, 2) px; None for a family that isn't its own."""

OURS = "tagmill auto"
ONE_LOOK, FOUR_LOOKS = "tagmill one look", "tagmill four looks"
"""Points of the trade-off between time and recall; `auto` looks twice, `thorough` six times."""
YARDSTICK, TARGET = "AprilTag 3 decimate 1", "AprilTag 3 decimate 2"


def contenders() -> tuple[dict[str, Search], list[str]]:
    """Name to search, ours first, and the names of those that aren't installed."""
    table: dict[str, Search] = {
        OURS: _opened("auto"),
        ONE_LOOK: _by_family(lambda family: PatternDetector(family, FAST[:1])),
        FOUR_LOOKS: _by_family(lambda family: PatternDetector(family, (*FAST, *THOROUGH[3:5]))),
        "tagmill thorough": _opened("auto", thorough=True),
        "tagmill opencv": _opened("opencv"),
        "cv2 defaults": _cv2(cv2.aruco.CORNER_REFINE_NONE, 0.0),
        "cv2 SUBPIX": _cv2(cv2.aruco.CORNER_REFINE_SUBPIX, 0.0),
        # Its first pixel's centre is (0.5, 0.5), unlike that of cv2's other methods.
        "cv2 APRILTAG": _cv2(cv2.aruco.CORNER_REFINE_APRILTAG, 0.5),
    }
    absent = []
    if find_spec("pupil_apriltags") is not None:
        table |= {YARDSTICK: _apriltag(1.0), "AprilTag 3 decimate 1.5": _apriltag(1.5), TARGET: _apriltag(2.0)}
    else:
        absent.append("AprilTag 3 (pip install 'tagmill[apriltag]')")
    if find_spec("locus") is not None:
        os.environ.setdefault("RAYON_NUM_THREADS", "1")
        table["locus grid"] = _opened("locus")
    else:
        absent.append("locus (pip install 'tagmill[locus]')")
    return table, absent


def _opened(detector: str, *, thorough: bool = False) -> Search:
    return _by_family(lambda family: open_detector(family, Path(), thorough=thorough, detector=detector))


def _apriltag(decimate: float) -> Search:
    return _by_family(lambda family: AprilTagDetector(family, decimate=decimate))


def _by_family(opening: Callable[[Family], MarkerDetector]) -> Search:
    """A search that opens its detector for a family when it is first needed."""
    opened: dict[str, MarkerDetector | None] = {}

    def search(grey: Grey, family: Family) -> Found | None:
        if family.name not in opened:
            try:
                opened[family.name] = opening(family)
            except ConfigError:  # not one of its families
                opened[family.name] = None
        detector = opened[family.name]
        if detector is None:
            return None
        return [(one.id, np.array(one.corners)) for one in detector.detect(grey)]

    return search


def _cv2(refinement: int, first_centre: float) -> Search:
    opened: dict[str, cv2.aruco.ArucoDetector] = {}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement

    def search(grey: Grey, family: Family) -> Found | None:
        if family.name not in opened:
            opened[family.name] = cv2.aruco.ArucoDetector(family.dictionary, parameters)
        quads, ids, _ = opened[family.name].detectMarkers(grey)
        if not len(quads):
            return []
        own = list(family.own_order)
        corners = [np.asarray(quad, dtype=np.float64).reshape(4, 2)[own] - first_centre for quad in quads]
        return [(int(one), quad) for one, quad in zip(np.asarray(ids).ravel(), corners, strict=True)]

    return search
