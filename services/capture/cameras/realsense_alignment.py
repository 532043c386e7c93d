"""A RealSense's depth as its colour camera would have measured it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel
from services.capture.cameras.realsense_geometry import camera_model
from services.capture.cameras.realsense_sdk import rs

Array = NDArray[np.float64]
Map = NDArray[np.float32]
Track = tuple[Map, Map]
Depth = NDArray[np.uint16]
WORTH = 0.0002
"""Depth that would change by less than this share is left as it is."""
OUTSIDE = -10.0


class DepthAligner:
    """Depth pictures as the colour camera would see them: (H, W) uint16 of its size, z in *its* frame, 0 = invalid.

    ``rs.align`` says which surface a colour pixel sees, and three things that it leaves open are put right here. On
    x86 it ignores the colour camera's distortion (all models but ``modified_brown_conrady``), so that its result is
    undistorted: each pixel is looked up where an undistorted camera has it. It spreads each depth pixel over the
    colour pixels around it and keeps the nearest, on a slope up to 1.5 % too near: the point found so is projected
    into the depth picture, and what was measured there is taken. And it keeps z as the depth camera has it: a turn of
    half a degree between the two is 4 mm at a metre in the corner of the picture.

    Where both pictures come from one eye (D405) nothing is done: the SDK would leave rows of holes.
    """

    def __init__(self, colour_profile: Any, depth_profile: Any, unit_mm: float) -> None:
        colour, depth = colour_profile.get_intrinsics(), depth_profile.get_intrinsics()
        extrinsics = depth_profile.get_extrinsics_to(colour_profile)
        self._align: Any | None = None
        self._lookup: tuple[Map, Map] | None = None
        if _same_eye(colour, depth, extrinsics):
            return
        self._align = rs.align(rs.stream.color)
        model = camera_model(colour)
        rays = _rays(model)
        bent = bool(model.distortion.any()) or model.model == "fisheye"
        if bent and colour.model != rs.distortion.modified_brown_conrady:
            self._lookup = _lookup(model, rays)
        rotation = np.array(extrinsics.rotation, np.float64).reshape(3, 3).T  # the SDK's are column by column
        translation = np.array(extrinsics.translation, np.float64) * 1000
        # In the depth camera's frame a ray of the colour camera is z * turned - shift, z in the colour camera's.
        turned = np.dstack([rays, np.ones(rays.shape[:2])]) @ rotation
        shift = rotation.T @ translation
        along = np.where(np.isfinite(turned[..., 2]) & (turned[..., 2] > 0), turned[..., 2], np.nan)
        gain = np.nan_to_num(1 / along, nan=1.0)
        self._gain = gain.astype(np.float32) if np.abs(gain - 1).max() > WORTH else None
        self._offset = round(float(shift[2]) / unit_mm)
        self._there = [
            _track(turned[..., axis] / along, shift[axis], shift[2], focal, centre, unit_mm)
            for axis, focal, centre in ((0, depth.fx, depth.ppx), (1, depth.fy, depth.ppy))
        ]

    def align(self, frameset: Any) -> Depth:
        """The depth picture of a frameset that has colour and depth, as an array of its own."""
        measured: Any = np.asanyarray(frameset.get_depth_frame().get_data())
        if self._align is None:
            return np.array(measured, dtype=np.uint16)
        depth: Any = np.asanyarray(self._align.process(frameset).get_depth_frame().get_data())
        if self._lookup is not None:
            depth = _looked_up(depth, *self._lookup)
        depth = self._measured(depth, measured)
        if self._offset:
            moved = depth.astype(np.int32) + self._offset
            moved[depth == 0] = 0
            depth = moved.clip(0, 65535).astype(np.uint16)
        if self._gain is not None:
            depth = cv2.multiply(depth, self._gain, dtype=cv2.CV_16U)
        return np.asarray(depth, dtype=np.uint16)

    @property
    def coverage(self) -> float:
        """The share (0..1) of the picture for which there can be depth: the rest is bent out of the SDK's reach."""
        if self._lookup is None:
            return 1.0
        across, down = self._lookup
        height, width = across.shape
        return float(((across > -0.5) & (across < width - 0.5) & (down > -0.5) & (down < height - 0.5)).mean())

    def _measured(self, depth: Depth, measured: Depth) -> Depth:
        """What the depth camera measured at the points that the aligned picture tells; 0 where that tells none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            near = np.reciprocal(depth.astype(np.float32))
            (across, slope_u), (down, slope_v) = self._there
            u, v = across + slope_u * near, down + slope_v * near
        return _looked_up(measured, u, v)


def _track(direction: Array, shift: float, shift_z: float, focal: float, centre: float, unit_mm: float) -> Track:
    """Where in the depth picture the ray of each colour pixel is: a + b / d, of which this gives a and b (H, W).

    d is the depth there by the depth camera, in steps. With the ray z * (X, Y, Z) - (sx, sy, sz) in its frame, and so
    d = z * Z - sz, the pixel is f * (z * X - sx) / d + c = f * X / Z + c + f * (X / Z * sz - sx) / d.
    """
    constant = direction * focal + centre
    slope = (direction * shift_z - shift) * focal / unit_mm
    return np.nan_to_num(constant, nan=OUTSIDE).astype(np.float32), np.nan_to_num(slope).astype(np.float32)


def _looked_up(depth: Depth, across: Map, down: Map) -> Depth:
    found = cv2.remap(depth, across, down, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(found, dtype=np.uint16)


def _rays(model: CameraModel) -> Array:
    """x/z, y/z (H, W, 2) of each pixel; NaN where there is no ray."""
    if not model.distortion.any() and model.model == "pinhole":
        across, down = np.meshgrid(np.arange(model.width), np.arange(model.height))
        matrix = model.matrix
        return np.stack([(across - matrix[0, 2]) / matrix[0, 0], (down - matrix[1, 2]) / matrix[1, 1]], axis=-1)
    # A ray every few pixels, the rest between them: exact to some 0.001 px, and ready in no time.
    columns, rows = model.width // 8 + 1, model.height // 8 + 1
    across, down = np.meshgrid(np.linspace(0, model.width - 1, columns), np.linspace(0, model.height - 1, rows))
    coarse = model.normalise(np.column_stack([across.ravel(), down.ravel()])).reshape(rows, columns, 2)
    x = np.linspace(0, columns - 1, model.width, dtype=np.float32)
    y = np.linspace(0, rows - 1, model.height, dtype=np.float32)
    across, down = np.meshgrid(x, y)
    return np.asarray(cv2.remap(coarse.astype(np.float32), across, down, cv2.INTER_LINEAR), dtype=np.float64)


def _same_eye(colour: Any, depth: Any, extrinsics: Any) -> bool:
    """Whether a pixel of the one picture is the same pixel of the other."""
    kept = ("width", "height", "fx", "fy", "ppx", "ppy", "coeffs")
    same = all(getattr(colour, key) == getattr(depth, key) for key in kept)
    lenses = colour.model == depth.model or not any(colour.coeffs)
    placed = np.allclose(extrinsics.rotation, np.eye(3).ravel(), atol=1e-6) and not any(extrinsics.translation)
    return same and lenses and placed


def _lookup(model: CameraModel, rays: Array) -> tuple[Map, Map]:
    """Where the same camera without distortion has each pixel's ray, as cv2.remap wants it."""
    matrix = model.matrix
    across = np.nan_to_num(rays[..., 0] * matrix[0, 0] + matrix[0, 2], nan=OUTSIDE)
    down = np.nan_to_num(rays[..., 1] * matrix[1, 1] + matrix[1, 2], nan=OUTSIDE)
    return across.astype(np.float32), down.astype(np.float32)
