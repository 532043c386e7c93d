"""Decoding pictures that strangers made: no decoder's error and no decompression bomb gets past this module."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 512 << 20
"""Of a picture's file: ``common.MOST_PIXELS`` of 16-bit colour, not compressed at all, are less."""


def decode(data: bytes | NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    """The picture in ``data`` as ``cv2.imdecode`` gives it with ``flags``.

    None for what is none or has more than ``common.MOST_PIXELS``; cv2 raises for some damage and returns None for
    other.
    """
    raw = data if isinstance(data, np.ndarray) else np.frombuffer(data, dtype=np.uint8)
    if not raw.size:
        return None
    try:
        return cv2.imdecode(raw, flags)
    except cv2.error:
        return None
