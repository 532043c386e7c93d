"""Detection with the AprilTag library (E. Olson, J. Wang, IROS 2016), by the optional package pupil-apriltags."""

from __future__ import annotations

import atexit
from typing import Any

import numpy as np

from common.errors import ConfigError
from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey
from services.detect.markers.quads import as_quad, check

FAMILIES = {"apriltag_16h5": "tag16h5", "apriltag_25h9": "tag25h9", "apriltag_36h11": "tag36h11"}
"""Families that the library shares with cv2, and its names for them."""
LEAST_MARGIN = {"apriltag_16h5": 40.0}
"""Decision margin (grey levels) below which a find is refused: the library sees 16h5 tags in ordinary pictures."""
OWN_ORDER = [3, 2, 1, 0]
"""Turns the library's corner order into TL TR BR BL of the marker's own frame."""

_opened: dict[str, Any] = {}


class AprilTagDetector:
    """Markers of one AprilTag family by AprilTag 3.

    One library object a process, as several end it with an abort; it serves every instance of this class.
    ``decimate`` is the library's quad_decimate: 1 finds what there is to be found, 2 is faster and loses small
    markers. ``thorough`` changes nothing: decimate 1 *is* the library's thorough search.
    """

    def __init__(self, family: Family, *, thorough: bool = False, decimate: float = 1.0) -> None:
        del thorough
        self.family = family
        self._decimate = decimate
        self._library = _open(family)
        self._least_margin = LEAST_MARGIN.get(family.name, 0.0)

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8; ``kind`` is ``apriltag``. Raises ValueError for another shape."""
        check(grey)
        self._library.tag_detector_ptr.contents.quad_decimate = self._decimate
        return [
            # Its first pixel's centre is (0.5, 0.5).
            DetectedMarker(
                id=int(tag.tag_id), corners=as_quad(np.asarray(tag.corners)[OWN_ORDER] - 0.5), kind="apriltag"
            )
            for tag in self._library.detect(np.ascontiguousarray(grey))
            if tag.decision_margin >= self._least_margin
        ]


def _open(family: Family) -> Any:
    """The process's library object; raises ConfigError where there is none for this family."""
    name = FAMILIES.get(family.name)
    if name is None:
        raise ConfigError(
            f"the detector 'apriltag' knows the families {', '.join(FAMILIES)}, not {family.name}; "
            "set markers.detector to auto or opencv"
        )
    try:
        from pupil_apriltags import Detector
    except ImportError as error:
        raise ConfigError(
            "markers.detector is 'apriltag', but pupil-apriltags isn't installed: pip install 'tagmill[apriltag]'"
        ) from error
    if name not in _opened:
        if _opened:
            raise ConfigError(f"the AprilTag library searches for {next(iter(_opened))} in this process, not {name}")
        _opened[name] = Detector(name, nthreads=1, quad_decimate=1.0)
        atexit.register(_leave_to_the_system, _opened[name])
    return _opened[name]


def _leave_to_the_system(library: Any) -> None:
    """The wrapper's destructor corrupts the heap (1.0.4); without its pointer it does nothing."""
    library.tag_detector_ptr = None
