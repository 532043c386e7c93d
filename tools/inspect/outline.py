"""Label against picture: are there edges where the pose puts the object's outline? Pure."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, CameraModel, Face, Pose, hidden

Array = NDArray[np.float64]

_POINTS = 24
"""Along each edge, away from its ends."""
_STEPS = np.arange(-12, 13)
_STEP_SHARE = 0.012
"""Of the outline's extent: one step of the search around it."""
_LEAST_POINTS = 40
_NEAR = 1
"""Steps within which the best edge still counts as being there: blur, rounding, a last half pixel of the pose."""
_STRONG = 3.0
"""Gradients beyond this many times the picture's mean count as that: one glossy edge must not decide."""


def outline_support(
    grey: NDArray[np.uint8], box: Box, pose: Pose, others: Sequence[tuple[Box, Pose]], camera: CameraModel
) -> float | None:
    """By how many standard deviations the edges along a box's outline exceed those around it; None: not to be seen.

    The gradient across the projected edges of all faces that are turned to the camera is averaged along them, there
    and at 24 x 24 displacements by up to a seventh of the outline's extent. A label of another picture, or one that
    is off by a few percent, has nothing special at its place (about 0); a right one stands out (3 and more).
    """
    points, normals = _edge_points(box, pose, others, camera)
    if len(points) < _LEAST_POINTS:
        return None
    across, down = gradients(grey)
    step = max(float(np.ptp(points, axis=0).max()) * _STEP_SHARE, 1.0)
    shifts = np.stack(np.meshgrid(_STEPS, _STEPS), axis=-1).reshape(-1, 2) * step
    at = (points[None] + shifts[:, None]).astype(np.float32)
    found = [
        cv2.remap(part, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in (across, down)
    ]
    along = np.abs(found[0] * normals[None, :, 0] + found[1] * normals[None, :, 1])
    limit = _STRONG * float(np.abs(across).mean() + np.abs(down).mean())
    support = np.minimum(along, max(limit, 1e-6)).mean(axis=1).reshape(len(_STEPS), len(_STEPS))
    middle, spread = len(_STEPS) // 2, float(support.std())
    here = support[middle - _NEAR : middle + _NEAR + 1, middle - _NEAR : middle + _NEAR + 1].max()
    return 0.0 if spread < 1e-9 else float((here - support.mean()) / spread)


def gradients(grey: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The slightly smoothed picture's derivatives across and down, (H, W) each."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0).astype(np.float32)
    return (
        np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), dtype=np.float32),
        np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1), dtype=np.float32),
    )


def facing(box: Box, pose: Pose) -> list[Face]:
    """The faces whose front the camera sees."""
    found = []
    for face in FACES.values():
        on = box.face_pose(face.name)
        normal, centre = pose.rotation @ on.rotation[:, 2], pose.apply(on.translation)[0]
        if float(normal @ centre) < 0:
            found.append(face)
    return found


def _edge_points(box: Box, pose: Pose, others: Sequence[tuple[Box, Pose]], camera: CameraModel) -> tuple[Array, Array]:
    """Points (N, 2) along the visible edges, in the picture, with the unit normals (N, 2) there."""
    share = np.linspace(0.06, 0.94, _POINTS)[:, None]
    lines: dict[frozenset[tuple[float, ...]], Array] = {}
    for face in facing(box, pose):
        corners = box.face_polygon(face.name)
        for here, there in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            lines[frozenset((tuple(here), tuple(there)))] = here + share * (there - here)
    points, normals = [], []
    for line in lines.values():
        xyz = pose.apply(line)
        pixels, front = camera.project(xyz)
        if not front.all():
            continue
        tangent = np.gradient(pixels, axis=0)
        length = np.linalg.norm(tangent, axis=1)
        seen = camera.contains(pixels) & ~hidden(xyz, others) & (length > 1e-6)
        points.append(pixels[seen])
        normals.append(np.column_stack([-tangent[seen, 1], tangent[seen, 0]]) / length[seen, None])
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 2))
    return np.concatenate(points), np.concatenate(normals)
