"""A lens taken out of pixels and put in again. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel

Array = NDArray[np.float64]


class Lens:
    """Pixels of the picture to pixels of the same camera without distortion, and back."""

    def __init__(self, camera: CameraModel | None) -> None:
        self._camera = camera if camera is not None and camera.distortion.any() else None

    def undistort(self, pixels: Array) -> Array:
        """Pixels (N, 2) of the picture to those of the camera without its lens."""
        if self._camera is None:
            return pixels
        matrix = self._camera.matrix
        return self._camera.normalise(pixels) @ matrix[:2, :2].T + matrix[:2, 2]

    def distort(self, pixels: Array) -> Array:
        """And back."""
        if self._camera is None:
            return pixels
        flat = np.linalg.solve(self._camera.matrix[:2, :2], (pixels - self._camera.matrix[:2, 2]).T).T
        # Any depth does: a projection doesn't depend on it.
        projected, _ = self._camera.project(np.column_stack([flat, np.ones(len(flat))]) * 1000.0)
        return projected
