"""What of an object the camera can see, from geometry alone. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, MarkerOnSide, Pose, hidden
from common.geometry.camera import NEAR_MM
from common.labels import FaceName

Array = NDArray[np.float64]

_NORMALS = {name: np.array(face.normal, dtype=np.float64) for name, face in FACES.items()}
_SAMPLES = np.linspace(-0.5, 0.5, 5)


def viewing_angle(pose: Pose, face: FaceName, at: Array) -> float:
    """Angle (deg) between a face's normal and the sight line from ``at`` (3,), a point of it in the object frame.

    0 is squarely facing the camera, above 90 the face is turned away.
    """
    point = pose.rotation @ at + pose.translation
    cosine = -float(pose.rotation @ _NORMALS[face] @ point) / max(math.hypot(*point), 1e-12)
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def facing_side(box: Box, pose: Pose) -> tuple[str, FaceName, float] | None:
    """Class, face and viewing angle (deg) of the side that faces the camera most; None if none does."""
    eye = pose.inverse().translation
    x, y, z = (float(value) for value in eye)
    square = x * x + y * y + z * z
    best: tuple[float, str, FaceName] | None = None
    for side in box.sides:
        a, b, c = FACES[side.face].normal
        half, along = box.face_size(side.face)[2] / 2, a * x + b * y + c * z
        # From the face's centre to the camera, against its normal; plain numbers, since this is asked of every view.
        cosine = (along - half) / max(math.sqrt(max(square - 2 * half * along + half * half, 0.0)), 1e-12)
        if cosine > 0.0 and (best is None or cosine > best[0]):
            best = cosine, side.class_name, side.face
    return None if best is None else (best[1], best[2], math.degrees(math.acos(min(best[0], 1.0))))


def marker_angle(pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide) -> float:
    """Viewing angle (deg) of a side at the marker's centre."""
    return viewing_angle(pose, side.face, box.marker_pose(side, marker).translation)


def faces_camera(pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide) -> bool:
    """Whether the marker's printed surface is turned to the camera and the marker's centre lies before it."""
    depth = float(pose.rotation[2] @ box.marker_pose(side, marker).translation + pose.translation[2])
    return depth > NEAR_MM and marker_angle(pose, box, side, marker) < 90.0


def marker_hidden(
    pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide, others: Sequence[tuple[Box, Pose]]
) -> bool:
    """Whether the whole marker lies hidden behind other objects."""
    if not others:
        return False
    x, y = np.meshgrid(_SAMPLES, _SAMPLES)
    grid = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * (marker.size_mm + 2 * marker.border_mm)
    points = pose.apply(box.marker_pose(side, marker).apply(grid))
    return bool(hidden(points, others).all())
