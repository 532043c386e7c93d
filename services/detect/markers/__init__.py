"""Marker detectors behind one small contract; ``registry.open_detector`` opens one."""

from services.detect.markers.base import MarkerDetector
from services.detect.markers.registry import open_detector

__all__ = ["MarkerDetector", "open_detector"]
