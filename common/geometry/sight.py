"""Lines of sight: what cuboids hide from the camera. Pure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from common.geometry.box import Box
from common.geometry.pose import Pose

Array = NDArray[np.float64]

_REACHED = 1.0 - 1e-3
"""A sight line that ends on a surface must not count as blocked by that very surface."""


def hidden(points: Array, cuboids: Iterable[tuple[Box, Pose]]) -> NDArray[np.bool_]:
    """Which points (N, 3), camera frame, mm, are hidden behind (or inside) a cuboid; poses: object to camera."""
    blocked = np.zeros(len(points), dtype=bool)
    for box, pose in cuboids:
        width, height, depth = box.size_mm
        back = pose.inverse()
        eye = back.apply(np.zeros(3))[0]
        blocked |= _crosses(eye, back.apply(points), np.array([width, depth, height]) / 2)
    return blocked


def _crosses(eye: Array, ends: Array, half: Array) -> NDArray[np.bool_]:
    """Which segments from ``eye`` to ``ends`` pass through the axis-aligned cuboid of half size ``half``.

    Method: slabs (Kay and Kajiya 1986).
    """
    way = ends - eye
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    first, second = (-half - eye) / way, (half - eye) / way
    enters = np.minimum(first, second).max(axis=1)
    leaves = np.maximum(first, second).min(axis=1)
    crossed: NDArray[np.bool_] = (enters < leaves) & (leaves > 0) & (enters < _REACHED)
    return crossed
