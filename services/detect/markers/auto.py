"""The default detector: whichever finds most at its price, by family (docs/decisions/0007)."""

from __future__ import annotations

from collections.abc import Sequence

from common.markers import Family
from common.messages import DetectedMarker
from services.detect.markers.base import Grey, MarkerDetector, Search
from services.detect.markers.opencv import OpenCvDetector
from services.detect.markers.pattern import FAST, THOROUGH, PatternDetector

LEAST_BITS = 4
"""Correlation can't tell fewer bits a side from chance; cv2, which asks for every bit, can."""


class AutoDetector:
    """tagmill's own search; cv2's for families of fewer than ``LEAST_BITS`` bits a side."""

    def __init__(self, family: Family, *, thorough: bool = False) -> None:
        self.family = family
        levels = THOROUGH if thorough else FAST
        self._own = PatternDetector(family, levels) if family.bits >= LEAST_BITS else None
        self._chosen: MarkerDetector = self._own or OpenCvDetector(family, thorough=thorough)

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8. Raises ValueError for another shape."""
        return self._chosen.detect(grey)

    def search(self, grey: Grey) -> Search:
        """``detect`` in pieces, as far as the chosen one can be cut."""
        if self._own is not None:
            return (yield from self._own.search(grey))
        return self._chosen.detect(grey)

    def follow(self, grey: Grey, expected: Sequence[DetectedMarker]) -> list[DetectedMarker | None]:
        """Each expected marker where it is now, or None where it isn't found close by without a search."""
        return self._own.follow(grey, expected) if self._own is not None else [None] * len(expected)
