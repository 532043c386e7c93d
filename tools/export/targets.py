"""From an object's label to what a detector is to find in the exported picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import EDGES, FACES, Box, CameraModel, Pose
from common.labels import ObjectLabel, Window
from services.label.visibility import facing_side, viewing_angle
from services.label.windows import clip_near, clip_window, project_box
from tools.export.classes import Naming
from tools.export.model import Source, Target

Array = NDArray[np.float64]
_ALONG = 8
"""Points along an edge that a lens bends."""
MIN_PX = 1.0
"""What is thinner than a pixel can't be found by anybody."""
_MIN_SHARE = 0.05
"""Of a side that must be visible for it, or for an object by at least one of its sides, to be a target."""


def targets_of(
    source: Source, camera: CameraModel, naming: Naming, wanted: tuple[str, ...], *, all_sides: bool
) -> tuple[Target, ...]:
    """The targets of a sample in the picture of ``camera``; ``wanted``: names of objects (none: all)."""
    found: list[Target] = []
    for item in source.label.objects:
        if (wanted and item.name not in wanted) or _covered(item):
            continue
        box, pose = source.boxes[item.name], source.poses[item.name]
        if all_sides:
            found += _sides(item, box, pose, camera, naming)
            continue
        facing = facing_side(box, pose)
        name = naming.class_of(box, None if facing is None else facing[0])
        if name is not None:
            target = _whole(item, box, pose, camera, naming.names.index(name), name)
            found += [] if target is None else [target]
    return tuple(found)


def _covered(item: ObjectLabel) -> bool:
    """Whether the label says that (nearly) nothing of the object is to be seen."""
    return bool(item.faces) and all(face.visible_share < _MIN_SHARE for face in item.faces)


def _whole(item: ObjectLabel, box: Box, pose: Pose, camera: CameraModel, class_id: int, name: str) -> Target | None:
    projected = project_box(box, pose, camera)
    outline = clipped(_hull(camera.project(np.concatenate(_edges(box, pose, camera)))[0]), camera)
    if projected.window is None or not _large(projected.window) or len(outline) < 3:
        return None
    corners, states = _corners(item, box, pose, camera)
    return Target(
        class_id, name, item, box, pose, corners, states, outline, projected.window, projected.window_unclipped
    )


def _sides(item: ObjectLabel, box: Box, pose: Pose, camera: CameraModel, naming: Naming) -> list[Target]:
    """Each side with a class that is turned to the camera and, as far as the label says, visible."""
    shares = {face.face: face.visible_share for face in item.faces}
    corners, states = _corners(item, box, pose, camera)
    found = []
    for side in box.sides:
        name = naming.class_of(box, side.class_name)
        angle = viewing_angle(pose, side.face, box.face_pose(side.face).translation)
        if name is None or angle >= 90.0 or shares.get(side.face, 1.0) < _MIN_SHARE:
            continue
        rim = camera.project(clip_near(_bent(pose.apply(box.face_polygon(side.face)), camera)))[0]
        outline = clipped(_hull(rim), camera)
        if len(outline) < 3:
            continue
        whole = _around(rim)
        window = clip_window(whole, camera)
        if window is None or not _large(window):
            continue
        found.append(
            Target(
                naming.names.index(name), name, item, box, pose, corners, states, outline, window, whole, is_side=True
            )
        )
    return found


def _corners(item: ObjectLabel, box: Box, pose: Pose, camera: CameraModel) -> tuple[Array, tuple[int, ...]]:
    pixels, _ = camera.project(pose.apply(box.corners))
    inside = camera.contains(pixels)
    hidden = [corner.visible is False for corner in item.corners]
    hidden += [False] * (len(pixels) - len(hidden))
    if all(corner.visible is None for corner in item.corners):
        hidden = [not seen for seen in _turned_here(box, pose)]
    states = tuple(0 if not inside[i] else 1 if hidden[i] else 2 for i in range(len(pixels)))
    return pixels, states


def _turned_here(box: Box, pose: Pose) -> NDArray[np.bool_]:
    """Corners (8,) of a face that is turned to the camera."""
    turned = np.zeros(len(box.corners), dtype=bool)
    for name, face in FACES.items():
        if viewing_angle(pose, name, box.face_pose(name).translation) < 90.0:
            turned |= box.corners @ np.array(face.normal, dtype=np.float64) > 0
    return turned


def _edges(box: Box, pose: Pose, camera: CameraModel) -> list[Array]:
    """Points (N, 3) of the twelve edges before the near plane, camera frame."""
    xyz = pose.apply(box.corners)
    steps = _steps(camera)
    lines = np.concatenate([xyz[a] + (xyz[b] - xyz[a]) * steps for a, b in EDGES])
    if (lines[:, 2] >= 1.0).all():
        return [lines]
    return [clip_near(pose.apply(box.face_polygon(face))) for face in FACES]


def _bent(polygon: Array, camera: CameraModel) -> Array:
    """A polygon (N, 3) with as many points along its edges as the lens needs."""
    steps = _steps(camera)[:-1]
    return np.concatenate(
        [here + (there - here) * steps for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)]
    )


def _steps(camera: CameraModel) -> Array:
    bends = bool(camera.distortion.any()) or camera.model == "fisheye"
    return np.linspace(0.0, 1.0, _ALONG if bends else 2)[:, None]


def _hull(pixels: Array) -> Array:
    kept = pixels[np.isfinite(pixels).all(axis=1)].astype(np.float32)
    if len(kept) < 3:
        return np.zeros((0, 2))
    return np.asarray(cv2.convexHull(kept), dtype=np.float64).reshape(-1, 2)


def clipped(polygon: Array, camera: CameraModel) -> Array:
    """The part of a convex polygon (N, 2) inside of the picture. Method: Sutherland and Hodgman 1974."""
    if len(polygon) and camera.contains(polygon).all():
        return polygon
    limits = ((0, -0.5, 1), (0, camera.width - 0.5, -1), (1, -0.5, 1), (1, camera.height - 0.5, -1))
    for axis, limit, sign in limits:
        kept: list[Array] = []
        for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            in_here, in_there = sign * (here[axis] - limit) >= 0, sign * (there[axis] - limit) >= 0
            if in_here:
                kept.append(here)
            if in_here != in_there:
                point = here + (there - here) * ((limit - here[axis]) / (there[axis] - here[axis]))
                point[axis] = limit
                kept.append(point)
        polygon = np.array(kept, dtype=np.float64).reshape(-1, 2)
    return polygon


def _around(pixels: Array) -> Window:
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return Window(x_min=float(low[0]), y_min=float(low[1]), x_max=float(high[0]), y_max=float(high[1]))


def _large(window: Window) -> bool:
    return window.x_max - window.x_min >= MIN_PX and window.y_max - window.y_min >= MIN_PX
