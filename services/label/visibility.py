"""What of an object the camera can see, from geometry alone. Pure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, MarkerOnSide, Pose
from common.geometry.camera import NEAR_MM
from common.labels import FaceName

Array = NDArray[np.float64]

_SAMPLES = np.linspace(-0.5, 0.5, 5)
_REACHED = 1.0 - 1e-3
"""A sight line that ends on a surface must not count as blocked by that very surface."""


def viewing_angle(pose: Pose, face: FaceName, at: Array) -> float:
    """Angle (deg) between a face's normal and the sight line from ``at`` (3,), a point of it in the object frame.

    0 is squarely facing the camera, above 90 the face is turned away.
    """
    normal = pose.rotation @ np.array(FACES[face].normal, dtype=np.float64)
    point = pose.apply(at)[0]
    cosine = float(-normal @ point / max(float(np.linalg.norm(point)), 1e-12))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def marker_angle(pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide) -> float:
    """Viewing angle (deg) of a side at the marker's centre."""
    return viewing_angle(pose, side.face, box.marker_pose(side, marker).translation)


def faces_camera(pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide) -> bool:
    """Whether the marker's printed surface is turned to the camera and the marker's centre lies before it."""
    centre = pose.apply(box.marker_pose(side, marker).translation)[0]
    return bool(centre[2] > NEAR_MM) and marker_angle(pose, box, side, marker) < 90.0


def hidden(points: Array, others: Iterable[tuple[Box, Pose]]) -> NDArray[np.bool_]:
    """Which points (N, 3), camera frame, mm, are hidden from the camera behind one of the cuboids."""
    blocked = np.zeros(len(points), dtype=bool)
    for box, pose in others:
        width, height, depth = box.size_mm
        half = np.array([width, depth, height]) / 2
        back = pose.inverse()
        eye = back.apply(np.zeros(3))[0]
        blocked |= _crosses(eye, back.apply(points), half)
    return blocked


def marker_hidden(
    pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide, others: Iterable[tuple[Box, Pose]]
) -> bool:
    """Whether the whole marker lies hidden behind other objects."""
    x, y = np.meshgrid(_SAMPLES, _SAMPLES)
    grid = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * (marker.size_mm + 2 * marker.border_mm)
    points = pose.apply(box.marker_pose(side, marker).apply(grid))
    return bool(hidden(points, others).all())


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
