"""Ground truth of a rendered frame, by projecting the very geometry that was drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from common.geometry import MARKER_CORNERS, Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import Point, Quad, Window
from common.messages import TrueMarker, TrueObject

Array = NDArray[np.float64]
_GRID = 6
"""A marker counts as covered if one of so many points by so many on its square is."""


def true_objects(boxes: Iterable[Box], camera: CameraModel, poses: Mapping[str, Pose]) -> tuple[TrueObject, ...]:
    """The truth of every box that lies wholly in front of the camera; ``poses``: object to camera frame.

    A marker is ``visible`` if its front is towards the camera, its four corners are in the picture and no
    other box covers any part of it.
    """
    placed = [box for box in boxes if box.name in poses]
    found = []
    for box in placed:
        pose = poses[box.name]
        pixels, front = camera.project(pose.apply(box.corners))
        if not front.all():
            continue
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        others = [(other, poses[other.name]) for other in placed if other is not box]
        markers = (_true_marker(box, side, marker, camera, pose, others) for side, marker in box.markers())
        rvec, tvec = pose.rvec, pose.translation
        found.append(
            TrueObject(
                name=box.name,
                rvec=(float(rvec[0]), float(rvec[1]), float(rvec[2])),
                tvec_mm=(float(tvec[0]), float(tvec[1]), float(tvec[2])),
                corners=tuple(_points(pixels)),
                window=Window(x_min=float(low[0]), y_min=float(low[1]), x_max=float(high[0]), y_max=float(high[1])),
                distance_mm=float(np.linalg.norm(tvec)),
                markers=tuple(marker for marker in markers if marker is not None),
            )
        )
    return tuple(found)


def _true_marker(
    box: Box, side: BoxSide, marker: MarkerOnSide, camera: CameraModel, pose: Pose, others: list[tuple[Box, Pose]]
) -> TrueMarker | None:
    """None if a corner lies behind the camera (a carrier that sticks out of its box can)."""
    to_camera = pose.after(box.marker_pose(side, marker))
    pixels, front = camera.project(to_camera.apply(MARKER_CORNERS * marker.size_mm))
    if not front.all():
        return None
    towards = float(to_camera.rotation[:, 2] @ to_camera.translation) < 0.0
    visible = towards and bool(camera.contains(pixels).all())
    if visible and others:
        steps = np.linspace(-0.5, 0.5, _GRID) * marker.size_mm
        x, y = np.meshgrid(steps, steps)
        points = to_camera.apply(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
        visible = not any(covers(other, other_pose, points).any() for other, other_pose in others)
    top_left, top_right, bottom_right, bottom_left = _points(pixels)
    corners: Quad = (top_left, top_right, bottom_right, bottom_left)
    return TrueMarker(id=marker.id, corners=corners, visible=visible)


def covers(box: Box, pose: Pose, points: Array) -> NDArray[np.bool_]:
    """Which points (N, 3) in the camera frame a box hides from the camera (slab test of the line of sight)."""
    back = pose.inverse()
    eye = back.apply(np.zeros(3))
    sight = back.apply(points) - eye
    width, height, depth = box.size_mm
    half = np.array([width, depth, height]) / 2
    sight = np.where(np.abs(sight) < 1e-12, 1e-12, sight)
    first, second = (-half - eye) / sight, (half - eye) / sight
    enters = np.minimum(first, second).max(axis=1)
    leaves = np.maximum(first, second).min(axis=1)
    hidden: NDArray[np.bool_] = (enters < leaves) & (leaves > 0.0) & (enters < 1.0)
    return hidden


def _points(pixels: Array) -> list[Point]:
    return [(float(x), float(y)) for x, y in pixels]
