"""A RealSense's factory intrinsics in OpenCV's models.

What the SDK's distortion models mean is told by its own ``rs2_project_point_to_pixel``, to which the tests hold this.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.geometry import CameraModel
from services.capture.cameras.realsense_sdk import rs

Array = NDArray[np.float64]
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
        f"the camera's distortion model {intrinsics.model.name} has no counterpart in OpenCV, so its pictures can't be "
        "labelled; take another mode or camera"
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
