"""The table of detectors, imported when one is opened."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from common.errors import ConfigError
from common.markers import Family
from common.markers import family as open_family
from services.detect.markers.base import MarkerDetector

DETECTORS: dict[str, str] = {
    "auto": "services.detect.markers.auto:AutoDetector",
    "opencv": "services.detect.markers.opencv:OpenCvDetector",
    "apriltag": "services.detect.markers.apriltag:AprilTagDetector",
    "locus": "services.detect.markers.locus:LocusDetector",
}
"""Detector's name to ``module:class``."""


def open_detector(
    family: Family | str, folder: Path, *, thorough: bool = False, detector: str = "auto"
) -> MarkerDetector:
    """A detector for a family (or its name, or its file relative to ``folder``).

    ``thorough`` trades time (about three times as much) for recall; it is for pictures that wait, such as
    files with ``pace: consumer``. Raises ConfigError for an unknown family or detector,
    for a family that the detector doesn't have, and (saying what to install) where its package is missing.
    """
    target = DETECTORS.get(detector)
    if target is None:
        raise ConfigError(f"there is no marker detector '{detector}'; known are {', '.join(DETECTORS)}")
    module, _, name = target.partition(":")
    resolved = family if isinstance(family, Family) else open_family(family, folder)
    opened: MarkerDetector = getattr(import_module(module), name)(resolved, thorough=thorough)
    return opened
