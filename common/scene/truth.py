"""Ground truth of a rendered frame, by projecting the very geometry that was drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from common.geometry import MARKER_CORNERS, Box, CameraModel, Pose, hidden
from common.labels import Point, Quad, Window
from common.messages import TrueMarker, TrueObject

Array = NDArray[np.float64]
_GRID = 6
"""A marker counts as covered if one of so many points by so many on its square is."""


def _grid_weights() -> Array:
    """Weights (points, 4) of the corners TL TR BR BL for a grid of points over a square."""
    across, down = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, _GRID), np.linspace(0, 1, _GRID)))
    weights: Array = np.stack(
        [(1 - across) * (1 - down), across * (1 - down), across * down, (1 - across) * down], axis=1
    )
    return weights


_GRID_WEIGHTS = _grid_weights()


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
        rvec, tvec = pose.rvec, pose.translation
        found.append(
            TrueObject(
                name=box.name,
                rvec=(float(rvec[0]), float(rvec[1]), float(rvec[2])),
                tvec_mm=(float(tvec[0]), float(tvec[1]), float(tvec[2])),
                corners=tuple(_points(pixels)),
                window=Window(x_min=float(low[0]), y_min=float(low[1]), x_max=float(high[0]), y_max=float(high[1])),
                distance_mm=float(np.linalg.norm(tvec)),
                markers=_true_markers(
                    box, pose, camera, [(other, poses[other.name]) for other in placed if other is not box]
                ),
            )
        )
    return tuple(found)


def _true_markers(box: Box, pose: Pose, camera: CameraModel, others: list[tuple[Box, Pose]]) -> tuple[TrueMarker, ...]:
    """Markers of a box, without those that have a corner behind the camera (a carrier that sticks out can)."""
    markers = box.markers()
    if not markers:
        return ()
    frames = [pose.after(box.marker_pose(side, marker)) for side, marker in markers]
    corners = np.array(
        [frame.apply(MARKER_CORNERS * marker.size_mm) for frame, (_, marker) in zip(frames, markers, strict=True)]
    )
    pixels, front = camera.project(corners.reshape(-1, 3))
    quads, ahead = pixels.reshape(-1, 4, 2), np.asarray(front.reshape(-1, 4).all(axis=1))
    whole = camera.contains(pixels).reshape(-1, 4).all(axis=1)
    towards = np.array([float(frame.rotation[:, 2] @ frame.translation) < 0.0 for frame in frames])
    visible = np.asarray(ahead & whole & towards, dtype=bool)
    if others and visible.any():
        # Any point of the square is a mean of its corners; in the camera frame as well.
        points = np.einsum("kc,mcx->mkx", _GRID_WEIGHTS, corners[visible])
        covered = hidden(points.reshape(-1, 3), others).reshape(len(points), -1).any(axis=1)
        visible[np.flatnonzero(visible)[covered]] = False
    return tuple(
        TrueMarker(id=marker.id, corners=_quad(quad), visible=bool(seen))
        for (_, marker), quad, seen, known in zip(markers, quads, visible, ahead, strict=True)
        if known
    )


def _quad(pixels: Array) -> Quad:
    top_left, top_right, bottom_right, bottom_left = _points(pixels)
    return (top_left, top_right, bottom_right, bottom_left)


def _points(pixels: Array) -> list[Point]:
    return [(float(x), float(y)) for x, y in pixels]
