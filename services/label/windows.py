"""Projected corners, detection windows and side polygons of a posed box. Pure; never a NaN, never an infinity.

Windows are continuous pixel coordinates in which an integer is a pixel's centre, so the picture covers
[-0.5, width - 0.5] x [-0.5, height - 0.5], and a clipped window never reaches beyond that. A window's width is
``x_max - x_min`` without any "+ 1".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import CORNER_NAMES, EDGES, Box, CameraModel, Pose
from common.geometry.camera import NEAR_MM
from common.labels import Corner, FaceName, Point, Window

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ProjectedBox:
    """The eight corners in the order of ``CORNER_NAMES``, the window as it is, and cut to the picture (or None)."""

    corners: tuple[Corner, ...]
    window_unclipped: Window
    window: Window | None


def project_box(box: Box, pose: Pose, camera: CameraModel) -> ProjectedBox:
    """Project a box with lens distortion; ``pose`` is object to camera frame.

    The window is min/max of the eight corners (paper, section "detection window"); where corners lie behind the
    camera, the points where the box's edges pass the near plane stand in for them. Raises PoseError if the box lies
    wholly behind the camera or the pose is not finite.
    """
    if not pose.finite:
        raise PoseError(f"the pose of {box.name} is not finite", code="bad_pose")
    xyz = pose.apply(box.corners)
    pixels, front = camera.project(xyz)
    inside = camera.contains(pixels)
    corners = tuple(
        Corner(
            name=name,
            x=float(pixels[i, 0]) if front[i] else None,
            y=float(pixels[i, 1]) if front[i] else None,
            in_image=bool(front[i] and inside[i]),
        )
        for i, name in enumerate(CORNER_NAMES)
    )
    extent = pixels[front]
    if not front.all():
        crossings = _near_crossings(xyz)
        extent = np.concatenate([extent, camera.project(crossings)[0]])
    if not len(extent):
        raise PoseError(f"{box.name} lies wholly behind the camera", code="bad_pose")
    low, high = extent.min(axis=0), extent.max(axis=0)
    whole = Window(x_min=float(low[0]), y_min=float(low[1]), x_max=float(high[0]), y_max=float(high[1]))
    return ProjectedBox(corners, whole, clip_window(whole, camera))


def clip_window(window: Window, camera: CameraModel) -> Window | None:
    """The part of a window that lies in the picture; None if there is none."""
    x_min, x_max = max(window.x_min, -0.5), min(window.x_max, camera.width - 0.5)
    y_min, y_max = max(window.y_min, -0.5), min(window.y_max, camera.height - 0.5)
    if x_min >= x_max or y_min >= y_max:
        return None
    return Window(x_min=x_min, y_min=y_min, x_max=x_max, y_max=y_max)


def side_polygon(box: Box, face: FaceName, pose: Pose, camera: CameraModel) -> tuple[Point, ...]:
    """The outline of a face in pixels, cut at the near plane, not at the picture's edge; empty if behind."""
    return points(camera.project(clip_near(pose.apply(box.face_polygon(face))))[0])


def clip_near(polygon: Array) -> Array:
    """The part of a convex polygon (N, 3), camera frame, that lies in front of the near plane; may be (0, 3).

    Method: Sutherland and Hodgman 1974.
    """
    if polygon[:, 2].min(initial=np.inf) >= NEAR_MM:
        return polygon
    kept: list[Array] = []
    for here, there in zip(polygon, following(polygon), strict=True):
        if here[2] >= NEAR_MM:
            kept.append(here)
        if (here[2] >= NEAR_MM) != (there[2] >= NEAR_MM):
            kept.append(_at_near(here, there))
    return np.array(kept, dtype=np.float64).reshape(-1, 3)


def following(polygon: Array) -> Array:
    """The points of a polygon (N, D), each in the place of the one before it."""
    return np.concatenate([polygon[1:], polygon[:1]])


def along_sides(corners: Array, count: int) -> Array:
    """``count`` points along each side of a polygon (N, D), evenly from its corner on: (count N, D)."""
    shares = np.arange(count)[None, :, None] / count
    steps = corners[:, None, :] + (following(corners) - corners)[:, None, :] * shares
    return np.asarray(steps.reshape(-1, corners.shape[1]))


def points(pixels: Array) -> tuple[Point, ...]:
    """Pixels (N, 2) as they are written into labels."""
    return tuple((x, y) for x, y in pixels.tolist())


def _near_crossings(xyz: Array) -> Array:
    """Where the box's edges pass through the near plane (N, 3)."""
    crossings = [
        _at_near(xyz[first], xyz[second])
        for first, second in EDGES
        if (xyz[first, 2] >= NEAR_MM) != (xyz[second, 2] >= NEAR_MM)
    ]
    return np.array(crossings, dtype=np.float64).reshape(-1, 3)


def _at_near(here: Array, there: Array) -> Array:
    point: Array = here + (there - here) * ((NEAR_MM - here[2]) / (there[2] - here[2]))
    point[2] = NEAR_MM  # exactly, so that rounding can't put it behind the plane again
    return point
