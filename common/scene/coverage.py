"""How much of a square pixel lies on one side of a straight edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float32]
_NONE, _HALF, _SLIGHT = np.float32(0.0), np.float32(0.5), np.float32(1e-3)
REACH_PX = 0.75
"""A pixel whose centre is farther from an edge than this (half its diagonal) is not cut by it."""


def inner_share(distance: Values, across: Values | np.float32, down: Values | np.float32) -> Values:
    """The share 0..1 (float32) of each pixel that is inside a half-plane.

    ``distance``: of the pixels' centres from the edge in px, positive inside. ``across``, ``down``: the edge's unit
    normal. The exact area: the normal's two components are the widths of two boxes whose convolution is the pixel
    as the edge meets it. A linear ramp instead would let slanted edges wave by some hundredths of a pixel.
    """
    across, down = np.abs(across), np.abs(down)
    wide, narrow = np.maximum(across, down), np.maximum(np.minimum(across, down), _SLIGHT)
    far = np.abs(distance)
    tail = np.maximum((wide + narrow) * _HALF - far, _NONE)
    tail *= tail * (_HALF / (wide * narrow))
    beyond = np.where(far <= (wide - narrow) * _HALF, _HALF - far / wide, tail)
    return np.asarray(np.where(distance >= 0.0, np.float32(1.0) - beyond, beyond), dtype=np.float32)
