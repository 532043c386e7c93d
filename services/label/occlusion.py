"""What of a posed box can be seen: by geometry (its own far side, the picture's edge, other posed boxes) and,
with a depth picture, also what anything else hides. Pure.

Depth sensors are noisy (often 1 % of the distance) and have holes. So a point is not judged by its own pixel but by
the median of a patch, against the noise that the patches themselves show; a hole says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, CameraModel, Pose, hidden
from common.labels import FaceLabel, FaceName
from services.label.robust import median
from services.label.visibility import viewing_angle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Depths = NDArray[np.uint16]
Counts = NDArray[np.int64]

GRID = 16
"""Points sampled along each side of a face."""
_STEPS = (np.arange(GRID) + 0.5) / GRID - 0.5
_UNIT_GRID = np.array([(x, y, 0.0) for y in _STEPS for x in _STEPS])
INSET_PX = 4.0
"""A corner is judged a little inside its faces: at the corner itself the depth jumps to what is behind the box."""
_PATCH = np.array([(x, y) for y in range(-2, 3) for x in range(-2, 3)])
_HOLE = np.uint16(65535)
"""Stands for what wasn't measured, so that it is sorted behind all that was."""
MIN_VALID = 5
"""Of a patch's 25 pixels, for it to say anything."""
NEARER_MM = 15.0
NEARER_SHARE = 0.01
"""What lies nearer than the surface by less than this is the sensor's or the pose's error, not something before it."""
NEARER_SIGMA = 2.5
"""... and so is what lies nearer by less than this many sigma of the sensor's noise (of one pixel)."""
EDGE_ON_DEG = 80.0
"""Faces seen more steeply are too thin for a patch, where a broader one is at hand."""


@dataclass(frozen=True, eq=False)
class DepthPicture:
    """``values`` (H, W) uint16, aligned with the colour picture, 0 = nothing measured; ``unit_mm`` each."""

    values: NDArray[np.uint16]
    unit_mm: float


@dataclass(frozen=True, eq=False)
class Seen:
    """Which of the eight corners (8,) are visible, and the faces that are turned to the camera, broadest first."""

    corners: Mask
    faces: tuple[FaceLabel, ...]
    by_depth: bool

    def share(self, face: FaceName) -> float:
        """The visible share of a face, 0 if it is turned away."""
        return next((item.visible_share for item in self.faces if item.face == face), 0.0)


def look(
    box: Box,
    pose: Pose,
    camera: CameraModel,
    others: Sequence[tuple[Box, Pose]] = (),
    depth: DepthPicture | None = None,
    distance_sigma_mm: float = 0.0,
) -> Seen:
    """What is visible of ``box``; ``pose`` and those of the ``others``: object to camera frame.

    ``distance_sigma_mm``: one sigma of the pose's distance, which depth is compared with.
    """
    angles = {name: viewing_angle(pose, name, box.face_pose(name).translation) for name in FACES}
    facing = sorted((name for name, angle in angles.items() if angle < 90.0), key=lambda name: angles[name])
    points = {name: pose.apply(_grid(box, name)) for name in facing}
    open_ = {name: _unhidden(xyz, camera, others) for name, xyz in points.items()}
    corners = _turned_here(box, facing) & _unhidden(pose.apply(box.corners), camera, others)
    if depth is not None and facing:
        sensor = _Sensor(depth, camera, np.concatenate(list(points.values())), distance_sigma_mm)
        parts = np.split(sensor.surface_covered, len(facing))
        open_ = {name: mask & ~covered for (name, mask), covered in zip(open_.items(), parts, strict=True)}
        broad = [name for name in facing if angles[name] < EDGE_ON_DEG] or facing[:1]
        corners &= ~_covered_corners(box, pose, camera, broad, sensor)
    classes = {side.face: side.class_name for side in box.sides}
    faces = tuple(
        FaceLabel(face=name, class_name=classes.get(name), visible_share=float(open_[name].mean())) for name in facing
    )
    return Seen(corners, faces, depth is not None)


def _grid(box: Box, face: FaceName) -> Array:
    """Points (GRID ** 2, 3) spread evenly over a face, object frame."""
    width, height, _ = box.face_size(face)
    return box.face_pose(face).apply(_UNIT_GRID * (width, height, 0.0))


def _turned_here(box: Box, facing: Sequence[FaceName]) -> Mask:
    """Corners (8,) of at least one face that is turned to the camera."""
    turned = np.zeros(8, dtype=bool)
    for name in facing:
        turned |= _of_face(box, name)
    return turned


def _of_face(box: Box, face: FaceName) -> Mask:
    return np.asarray(box.corners @ np.array(FACES[face].normal, dtype=np.float64) > 0)


def _unhidden(xyz: Array, camera: CameraModel, others: Sequence[tuple[Box, Pose]]) -> Mask:
    """Points (N, 3), camera frame, that lie in the picture and behind no other box."""
    pixels, front = camera.project(xyz)
    return np.asarray(front & camera.contains(pixels) & ~hidden(xyz, others))


def _covered_corners(box: Box, pose: Pose, camera: CameraModel, faces: Sequence[FaceName], sensor: _Sensor) -> Mask:
    """Corners (8,) that something covers: on at least half of their faces, a little inside of them."""
    covered, judged = np.zeros(8), np.zeros(8)
    for name in faces:
        numbers = np.nonzero(_of_face(box, name))[0]
        corners, middle = pose.apply(box.corners[numbers]), pose.apply(box.face_pose(name).translation)[0]
        ends, _ = camera.project(corners)
        centre, _ = camera.project(middle)
        length = np.linalg.norm(ends - centre, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(np.isfinite(length), np.clip(INSET_PX / length, 0.0, 0.5), 0.5)
        covered[numbers] += sensor.covers(corners + (middle - corners) * share[:, None])
        judged[numbers] += 1
    return np.asarray((judged > 0) & (2 * covered >= judged) & (covered > 0))


class _Sensor:
    """A depth picture and how noisy it is, as its patches on the surface (N, 3) of a box show it.

    ``surface_covered`` (N,): before which of the surface's points something is measured.
    """

    def __init__(self, depth: DepthPicture, camera: CameraModel, surface: Array, distance_sigma_mm: float) -> None:
        self._depth, self._camera = depth, camera
        self._offset_mm = 2.0 * distance_sigma_mm
        values, count = self._patches(surface)
        middle = _median(values, count)
        measured = self._in_mm(middle, count)
        apart = np.maximum(values, middle[:, None]) - np.minimum(values, middle[:, None])
        apart[values == _HOLE] = _HOLE
        spread = 1.4826 * depth.unit_mm * _median(apart, count)
        known = measured > 0  # not so for NaN
        self._noise = median(spread[known] / measured[known]) if known.any() else 0.0
        self.surface_covered = self._nearer(measured, surface)

    def covers(self, xyz: Array) -> Mask:
        """Before which points (N, 3), camera frame, something is measured."""
        values, count = self._patches(xyz)
        return self._nearer(self._in_mm(_median(values, count), count), xyz)

    def _nearer(self, measured: Array, xyz: Array) -> Mask:
        z = xyz[:, 2]
        slack = np.maximum(NEARER_MM, np.maximum(NEARER_SHARE, NEARER_SIGMA * self._noise) * z) + self._offset_mm
        with np.errstate(invalid="ignore"):
            return np.asarray(measured < z - slack)

    def _in_mm(self, middle: Depths, count: Counts) -> Array:
        """The median (N,) mm of patches, NaN where too little of one was measured."""
        return np.where(count < MIN_VALID, np.nan, middle * self._depth.unit_mm)

    def _patches(self, xyz: Array) -> tuple[Depths, Counts]:
        """The values (N, 25) around each point, holes as ``_HOLE``, and how many (N,) are none; 0 off the picture."""
        pixels, front = self._camera.project(xyz)
        inside = front & self._camera.contains(pixels)
        height, width = self._depth.values.shape
        at = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(np.int64)
        columns = np.clip(at[:, 0, None] + _PATCH[:, 0], 0, width - 1)
        rows = np.clip(at[:, 1, None] + _PATCH[:, 1], 0, height - 1)
        values = self._depth.values.take(rows * width + columns)
        values[values == 0] = _HOLE
        return values, np.where(inside, (values != _HOLE).sum(axis=1), 0)


def _median(values: Depths, count: Counts) -> Depths:
    """The median of the ``count`` (N,) lowest values of each row (N, 25), the lower one of two."""
    ordered = np.sort(values, axis=1)
    return np.asarray(ordered[np.arange(len(values)), np.maximum(count - 1, 0) // 2])
