"""A label against itself and against the rig: what its own pose says must be what it says elsewhere. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import Box, CameraModel, Pose
from common.labels import ObjectLabel, Window
from services.label.windows import project_box, side_polygon

OFF_LIMIT_PX = 0.5
"""Beyond what rounding explains by far: the numbers of a label that tagmill wrote agree to 0.001 px."""
_FAR_PX = 1e4
"""What lies so far outside of the picture is limited by how the lens model is kept sane, not by the pose."""
_UNKNOWN_PX = 1e3


def off_px(item: ObjectLabel, box: Box, pose: Pose, camera: CameraModel) -> float:
    """How far (px) the label's corners, windows and side polygons are at most from where its own pose puts them."""
    try:
        there = project_box(box, pose, camera)
    except PoseError:
        return _UNKNOWN_PX
    pairs = [((one.x, one.y), (other.x, other.y)) for one, other in zip(item.corners, there.corners, strict=False)]
    distances = [_apart(one, other) for one, other in pairs]
    if len(item.corners) != len(there.corners):
        distances.append(_UNKNOWN_PX)
    distances.append(_windows_apart(item.window_unclipped, there.window_unclipped))
    distances.append(_windows_apart(item.window, there.window))
    for side in item.sides:
        polygon = side_polygon(box, side.face, pose, camera)
        if len(polygon) != len(side.polygon):
            distances.append(_UNKNOWN_PX)
        distances += [_apart(one, other) for one, other in zip(side.polygon, polygon, strict=False)]
    return float(np.nanmax(distances)) if np.isfinite(distances).any() else 0.0


def contradictions(item: ObjectLabel, box: Box, pose: Pose, camera: CameraModel) -> Iterator[str]:
    """What in an object's label contradicts the rig, or the object's own pose; a sentence each."""
    if item.type != box.type:
        yield f"{item.name} is a {box.type}, the label says {item.type}"
    placed = {marker.id: (side, marker) for side, marker in box.markers()}
    for side in item.sides:
        known = placed.get(side.marker)
        if known is None:
            yield f"marker {side.marker} is none of {item.name}'s"
            continue
        at, marker = known
        if (at.class_name, at.face) != (side.class_name, side.face):
            yield f"marker {side.marker} sits on {at.class_name}, the label says {side.class_name}"
        pixels, front = camera.project(pose.apply(box.marker_corners(at, marker)))
        away = float(np.linalg.norm(pixels - np.array(side.marker_corners), axis=1).max()) if front.all() else np.inf
        size = float(np.ptp(np.array(side.marker_corners), axis=0).max())
        if away > max(0.5 * size, 6.0):
            yield f"marker {side.marker} is {away:.0f} px from where the pose puts it"
    far = abs(item.distance_mm - float(np.linalg.norm(pose.translation)))
    if far > 1.0:
        yield f"its distance differs by {far:.0f} mm from its pose's"


def unknown_objects(names: Mapping[str, Box], item: ObjectLabel) -> str:
    """The sentence for an object that the rig doesn't have."""
    return f"{item.name} is none of the rig's objects ({', '.join(names) or 'there are none'})"


def window_array(window: Window) -> NDArray[np.float64]:
    """x_min, y_min, x_max, y_max."""
    return np.array([window.x_min, window.y_min, window.x_max, window.y_max])


def _apart(one: tuple[float | None, float | None], other: tuple[float | None, float | None]) -> float:
    if None in one or None in other:
        return 0.0 if one == other else _UNKNOWN_PX
    first, second = np.array(one, dtype=np.float64), np.array(other, dtype=np.float64)
    if max(np.abs(first).max(), np.abs(second).max()) > _FAR_PX:
        return 0.0
    return float(np.hypot(*(first - second)))


def _windows_apart(one: Window | None, other: Window | None) -> float:
    if one is None or other is None:
        return 0.0 if one is other else _UNKNOWN_PX
    first, second = window_array(one), window_array(other)
    near = (np.abs(first) < _FAR_PX) & (np.abs(second) < _FAR_PX)
    return float(np.abs(first - second)[near].max()) if near.any() else 0.0
