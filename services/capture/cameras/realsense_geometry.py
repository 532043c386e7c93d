"""A RealSense's factory intrinsics in OpenCV's models, and its depth seen from the colour camera.

What the SDK's distortion models mean is told by its own ``rs2_project_point_to_pixel``, to which the tests hold this.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.geometry import CameraModel
from services.capture.cameras.realsense_sdk import rs

Array = NDArray[np.float64]
Depth = NDArray[np.uint16]
Lookup = tuple[NDArray[np.float32], NDArray[np.float32]]
WORTH = 0.0002
"""Depth that would change by less than this share is left as it is."""
_GRID = (33, 25)


def camera_model(intrinsics: Any) -> CameraModel:
    """Factory intrinsics (``rs.intrinsics``) as OpenCV knows them. Pixels agree: integer = pixel centre.

    ``brown_conrady`` is cv2's k1 k2 p1 p2 k3 as it stands, ``kannala_brandt4`` cv2's fisheye. ``inverse_`` and
    ``modified_brown_conrady`` scale a point radially *before* its tangential shift, which cv2 doesn't: their
    coefficients are fitted to the SDK's projection over the picture (linear least squares in k1 k2 p1 p2 k3).
    Raises ConfigError for ``ftheta``, which is none of these.
    """
    matrix = np.array([[intrinsics.fx, 0, intrinsics.ppx], [0, intrinsics.fy, intrinsics.ppy], [0, 0, 1]], np.float64)
    size = (int(intrinsics.width), int(intrinsics.height))
    coefficients = np.array(intrinsics.coeffs, np.float64)
    if intrinsics.model == rs.distortion.kannala_brandt4:
        return CameraModel(*size, matrix, coefficients[:4], model="fisheye")
    if intrinsics.model == rs.distortion.none or not coefficients.any():
        return CameraModel(*size, matrix, np.zeros(5))
    if intrinsics.model == rs.distortion.brown_conrady:
        return CameraModel(*size, matrix, coefficients)
    if intrinsics.model in (rs.distortion.inverse_brown_conrady, rs.distortion.modified_brown_conrady):
        return CameraModel(*size, matrix, _fitted(coefficients, matrix, *size))
    raise ConfigError(
        f"the camera's distortion model {intrinsics.model.name} has no counterpart in OpenCV; calibrate it "
        "(tagmill calibrate) and name the file as `calibration`"
    )


def _fitted(coefficients: Array, matrix: Array, width: int, height: int) -> Array:
    """cv2's k1 k2 p1 p2 k3 that project most like the SDK's radial-first model over the picture."""
    start = CameraModel(width, height, matrix, coefficients)
    across, down = np.meshgrid(np.linspace(0, width - 1, _GRID[0]), np.linspace(0, height - 1, _GRID[1]))
    rays = start.normalise(np.column_stack([across.ravel(), down.ravel()]))
    rays = rays[np.isfinite(rays).all(axis=1)]
    k1, k2, p1, p2, k3 = coefficients
    x, y = rays.T
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    bent_x, bent_y = x * radial, y * radial
    shift_x = 2 * p1 * bent_x * bent_y + p2 * (r2 + 2 * bent_x * bent_x)
    shift_y = 2 * p2 * bent_x * bent_y + p1 * (r2 + 2 * bent_y * bent_y)
    unknowns = np.vstack(
        [
            np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3]),
            np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3]),
        ]
    )
    moved = np.concatenate([bent_x + shift_x - x, bent_y + shift_y - y])
    found: Array = np.linalg.lstsq(unknowns, moved, rcond=None)[0]
    return found


class DepthAligner:
    """Depth pictures as the colour camera would see them: (H, W) uint16 of its size, z in *its* frame, 0 = invalid.

    ``rs.align`` does the work, and two things on which it is silent are put right. On x86 it ignores the colour
    camera's distortion (all models but ``modified_brown_conrady``), so that its result is undistorted: each pixel is
    looked up where an undistorted camera has it. And it keeps z as the depth camera measured it: a turn between the
    two cameras of half a degree is 4 mm at a metre in the corner of the picture. Where both pictures come from one
    eye (D405) nothing is done: the SDK would leave rows of holes.
    """

    def __init__(self, colour_profile: Any, depth_profile: Any, unit_mm: float) -> None:
        intrinsics = colour_profile.get_intrinsics()
        extrinsics = depth_profile.get_extrinsics_to(colour_profile)
        self._align: Any | None = None
        self._lookup: Lookup | None = None
        self._gain: NDArray[np.float32] | None = None
        self._offset = 0
        if _same_eye(intrinsics, depth_profile.get_intrinsics(), extrinsics):
            return
        self._align = rs.align(rs.stream.color)
        model = camera_model(intrinsics)
        rays = _rays(model)
        bent = bool(model.distortion.any()) or model.model == "fisheye"
        ignored = bent and intrinsics.model != rs.distortion.modified_brown_conrady
        if ignored:
            self._lookup = _lookup(model, rays)
        rotation = np.array(extrinsics.rotation, np.float64).reshape(3, 3).T  # the SDK's are column by column
        translation = np.array(extrinsics.translation, np.float64) * 1000
        axis = rotation[:, 2]  # the depth camera's optical axis in the colour camera's frame
        along = rays[..., 0] * axis[0] + rays[..., 1] * axis[1] + axis[2]
        gain = np.where(np.isfinite(along) & (along > 0), 1 / along, 1.0)
        if np.abs(gain - 1).max() > WORTH:
            self._gain = gain.astype(np.float32)
        self._offset = round(float(axis @ translation) / unit_mm)

    def align(self, frameset: Any) -> Depth:
        """The depth picture of a frameset that has colour and depth, as an array of its own."""
        aligned = frameset if self._align is None else self._align.process(frameset)
        depth: Any = np.asanyarray(aligned.get_depth_frame().get_data())
        if self._lookup is None:
            depth = depth.copy()
        else:
            depth = cv2.remap(depth, *self._lookup, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
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


def _lookup(model: CameraModel, rays: Array) -> Lookup:
    """Where the same camera without distortion has each pixel's ray, as cv2.remap wants it."""
    matrix = model.matrix
    across = np.nan_to_num(rays[..., 0] * matrix[0, 0] + matrix[0, 2], nan=-10.0)
    down = np.nan_to_num(rays[..., 1] * matrix[1, 1] + matrix[1, 2], nan=-10.0)
    return across.astype(np.float32), down.astype(np.float32)
