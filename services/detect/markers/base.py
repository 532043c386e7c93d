"""What every marker detector does."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.markers import Family
from common.messages import DetectedMarker

Grey = NDArray[np.uint8]
Search = Generator[None, None, list[DetectedMarker]]
"""A search in pieces of a few milliseconds; what it returns in the end is what ``detect`` would have."""


class MarkerDetector(Protocol):
    """Finds the markers of one family; constructed with ``(family, thorough=...)``.

    A detector converts at its own border: corners are TL TR BR BL of the marker's *own* frame (AprilTag
    frames of cv2 are turned), in pixels with integer = pixel centre (AprilTag libraries put 0.5 there).
    """

    family: Family

    def detect(self, grey: Grey) -> list[DetectedMarker]:
        """The markers in a picture (H, W) uint8, which is only read.

        One entry for each physical marker: one that is found twice is reported once, two of equal id
        are both reported.
        """
        ...
