"""Depth against pose, and what is left of markers on the object's surfaces. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose, hidden
from common.markers import Family
from tools.inspect.outline import facing

Array = NDArray[np.float64]

_GRID = (np.stack(np.meshgrid(np.linspace(-0.42, 0.42, 14), np.linspace(-0.42, 0.42, 14)), axis=-1)).reshape(-1, 2)
_LEAST_POINTS = 60
_MOST_TILT = 0.26
"""Cosine of the angle (75 degrees) beyond which a face's depth says little."""
_LEAST_SIDE_PX = 12.0
_LEAST_CONTRAST = 4.0
"""Grey levels (standard deviation): less is the fill's grain, which correlates with anything."""


def depth_difference(
    depth_mm: NDArray[np.float64], box: Box, pose: Pose, others: Sequence[tuple[Box, Pose]], camera: CameraModel
) -> tuple[float, float] | None:
    """Median |measured - expected| and median (measured - expected) of a box's faces, mm; None: too little is measured.

    ``depth_mm`` (H, W): along the optical axis, 0 where nothing was measured.
    """
    points = [
        pose.apply(box.face_pose(face.name).apply(_on_face(box.face_size(face.name)[:2])))
        for face in facing(box, pose)
        if _tilt(box.face_pose(face.name), pose) > _MOST_TILT
    ]
    if not points:
        return None
    xyz = np.concatenate(points)
    pixels, front = camera.project(xyz)
    seen = front & camera.contains(pixels) & ~hidden(xyz, others)
    rows, columns = np.rint(pixels[seen, 1]).astype(int), np.rint(pixels[seen, 0]).astype(int)
    measured = depth_mm[rows, columns]
    known = measured > 0
    if int(known.sum()) < _LEAST_POINTS:
        return None
    off = measured[known] - xyz[seen, 2][known]
    return float(np.median(np.abs(off))), float(np.median(off))


def pattern_left(
    grey: NDArray[np.uint8],
    box: Box,
    pose: Pose,
    others: Sequence[tuple[Box, Pose]],
    camera: CameraModel,
    known: Family,
) -> tuple[float, int | None]:
    """The best correlation (-1..1) of the picture with a marker of the box at its place, and that marker's id.

    A marker that was erased leaves none; half a marker, or one too blurred to be decoded, still leaves 0.6 and more.
    """
    best: tuple[float, int | None] = (0.0, None)
    for side, marker in box.markers():
        value = _correlation(grey, box, side, marker, pose, others, camera, known)
        if value > best[0]:
            best = value, marker.id
    return best


def _correlation(
    grey: NDArray[np.uint8],
    box: Box,
    side: BoxSide,
    marker: MarkerOnSide,
    pose: Pose,
    others: Sequence[tuple[Box, Pose]],
    camera: CameraModel,
    known: Family,
) -> float:
    placed = box.marker_pose(side, marker)
    if marker.id >= known.ids or _tilt(placed, pose) < _MOST_TILT:
        return 0.0
    cells = known.cells
    at = (np.arange(cells) + 0.5) / cells - 0.5
    flat = np.stack([*np.meshgrid(at, -at), np.zeros((cells, cells))], axis=-1).reshape(-1, 3) * marker.size_mm
    xyz = pose.apply(placed.apply(flat))
    pixels, front = camera.project(xyz)
    seen = front & camera.contains(pixels)
    if seen.mean() < 0.5 or hidden(xyz, others).any():
        return 0.0
    extent = np.ptp(pixels[seen], axis=0)
    if float(extent.min()) < _LEAST_SIDE_PX:
        return 0.0
    maps = pixels[seen].astype(np.float32)
    values = cv2.remap(grey, maps[:, 0], maps[:, 1], cv2.INTER_LINEAR).ravel().astype(np.float64)
    bits = known.bitmap(marker.id).ravel().astype(np.float64)[seen]
    if values.std() < _LEAST_CONTRAST or bits.std() == 0.0:
        return 0.0
    return float(np.corrcoef(values, bits)[0, 1])


def _on_face(size: tuple[float, float]) -> Array:
    return np.column_stack([_GRID * np.array(size), np.zeros(len(_GRID))])


def _tilt(surface: Pose, pose: Pose) -> float:
    """Cosine of the angle between a surface's normal and the line of sight to its middle; negative: turned away."""
    normal, centre = pose.rotation @ surface.rotation[:, 2], pose.apply(surface.translation)[0]
    return float(-normal @ centre / max(float(np.linalg.norm(centre)), 1e-9))
