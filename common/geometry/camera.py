"""The camera model: OpenCV's pinhole and fisheye projection, kept sane outside the picture.

Camera frame: x right, y down, z forward, mm. Pixels: integer = pixel centre.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from common.labels import CameraLabel

Array = NDArray[np.float64]
NEAR_MM = 1.0
"""Points nearer than this to the camera's plane, or behind it, have no projection."""
ROUND_TRIP_PX = 0.01
"""A pixel whose ray doesn't project back to it within this has no ray."""
_ZERO = np.zeros(3)
MARGIN = 1.1
"""The distortion model is trusted to this multiple of the radius that the picture's corners need."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of one camera at one picture size.

    ``matrix`` 3x3 (px), ``distortion`` as cv2 wants it (pinhole: k1 k2 p1 p2 k3 ..., fisheye: k1..k4); ``straight``: a
    pinhole without distortion.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array
    model: Literal["pinhole", "fisheye"] = "pinhole"
    straight: bool = field(init=False, repr=False)
    _focal: Array = field(init=False, repr=False)
    _centre: Array = field(init=False, repr=False)
    _limit: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", np.asarray(self.matrix, dtype=np.float64).reshape(3, 3))
        object.__setattr__(self, "distortion", np.asarray(self.distortion, dtype=np.float64).ravel())
        object.__setattr__(self, "straight", self.model == "pinhole" and not self.distortion.any())
        object.__setattr__(self, "_focal", np.diag(self.matrix)[:2].copy())
        object.__setattr__(self, "_centre", self.matrix[:2, 2].copy())
        object.__setattr__(self, "_limit", self._trusted_radius())

    @classmethod
    def from_label(cls, label: CameraLabel) -> CameraModel:
        """From the form in which a camera describes itself; equal ones give the same model."""
        return _from_label(label)

    @classmethod
    def guess(cls, width: int, height: int, field_of_view_deg: float = 65.0) -> CameraModel:
        """An uncalibrated camera: square pixels, centred, no distortion, the given horizontal field of view."""
        focal = width / 2 / np.tan(np.radians(field_of_view_deg) / 2)
        matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        return cls(width, height, matrix, np.zeros(5))

    def project(self, points: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Project points (N, 3) in the camera frame (mm).

        Returns pixels (N, 2), NaN for points behind the camera, and a mask (N,) of those in front.
        Beyond the radius for which the distortion model was fitted (``MARGIN`` times the picture's corners,
        or where the radial polynomial turns back) the scale found at that radius is kept, so that a far-off
        corner is far off, never folds back into the picture and is not flung away by a high-order term.
        """
        xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        front = xyz[:, 2] >= NEAR_MM
        if len(xyz) and front.all():
            return self._project_normalised(xyz[:, :2] / xyz[:, 2:]), front
        pixels = np.full((len(xyz), 2), np.nan)
        if front.any():
            pixels[front] = self._project_normalised(xyz[front, :2] / xyz[front, 2:])
        return pixels, front

    def normalise(self, pixels: ArrayLike) -> Array:
        """Undistort pixels (N, 2) to x/z, y/z (N, 2) in the camera frame.

        NaN where no ray in front of the camera leads to a pixel: a strong barrel distortion or a fisheye has
        corners of the picture that its model can't reach, and cv2 returns arbitrary numbers there.
        """
        if self.straight:
            return (np.asarray(pixels, dtype=np.float64).reshape(-1, 2) - self._centre) / self._focal
        # cv2 takes every second row of a larger array for something else.
        uv = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        if not len(uv):
            return np.zeros((0, 2))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-9)
        if self.model == "fisheye":
            found = cv2.fisheye.undistortPoints(uv, self.matrix, self.distortion[:4], criteria=criteria)
        else:
            found = _undistorted(uv, self.matrix, self.distortion, criteria)
        rays = np.asarray(found, dtype=np.float64).reshape(-1, 2)
        if self.distortion.any() or self.model == "fisheye":
            with np.errstate(invalid="ignore"):
                again = self._project_normalised(rays)
                missed = ~(np.linalg.norm(again - uv[:, 0], axis=1) < ROUND_TRIP_PX)
            rays[missed | (np.hypot(rays[:, 0], rays[:, 1]) > self._limit)] = np.nan
        return rays

    def contains(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (N, 2) lie inside the picture's area, i.e. in [-0.5, width - 0.5) x [-0.5, height - 0.5)."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            inside: NDArray[np.bool_] = (
                (uv[:, 0] >= -0.5) & (uv[:, 0] < self.width - 0.5) & (uv[:, 1] >= -0.5) & (uv[:, 1] < self.height - 0.5)
            )
        return inside

    def _project_normalised(self, xy: Array) -> Array:
        if self.straight:
            return xy * self._focal + self._centre
        radius = np.hypot(xy[:, 0], xy[:, 1])
        beyond = radius > self._limit
        if not beyond.any():
            return self._distort(xy)
        scale = np.where(beyond, self._limit / np.maximum(radius, 1e-12), 1.0)[:, None]
        at_limit = self._distort(xy * scale)
        centre = self.matrix[:2, 2]
        return np.where(beyond[:, None], centre + (at_limit - centre) / scale, at_limit)

    def _distort(self, xy: Array) -> Array:
        xyz = np.ones((len(xy), 1, 3))
        xyz[:, 0, :2] = xy
        if self.model == "fisheye":
            pixels, _ = cv2.fisheye.projectPoints(xyz, _ZERO, _ZERO, self.matrix, self.distortion[:4])
        else:
            pixels, _ = cv2.projectPoints(xyz, _ZERO, _ZERO, self.matrix, self.distortion)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    def _trusted_radius(self) -> float:
        """Radius (x/z units) up to which the model is used as it stands."""
        if self.width < 1 or self.height < 1 or not self.distortion.any():
            return float("inf")
        corners = np.array([[0, 0], [self.width, 0], [self.width, self.height], [0, self.height]], dtype=float)
        centred = (corners - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]
        wanted = float(np.hypot(centred[:, 0], centred[:, 1]).max())
        if self.model == "fisheye":
            radii = np.tan(np.linspace(0.0, np.radians(89.9), 4001))
        else:
            radii = np.linspace(0.0, max(4.0 * wanted, 4.0), 4001)
        pixels = self._distort(np.column_stack([radii, np.zeros_like(radii)]))
        distorted = (pixels[:, 0] - self.matrix[0, 2]) / self.matrix[0, 0]
        rising = np.diff(distorted) > 0.0
        turn = int(np.argmin(rising)) if not rising.all() else len(radii) - 1
        reached = np.nonzero(distorted[: turn + 1] >= wanted)[0]
        if len(reached):
            return float(min(radii[reached[0]] * MARGIN, radii[turn] * 0.98))
        return float(max(radii[turn] * 0.98, radii[1]))


@lru_cache(maxsize=64)
def _from_label(label: CameraLabel) -> CameraModel:
    """Kept, for how far a lens is to be trusted takes a millisecond to find out, and every frame asks."""
    return CameraModel(label.width, label.height, np.array(label.matrix), np.array(label.distortion), model=label.model)


def _undistorted(uv: Array, matrix: Array, distortion: Array, criteria: tuple[int, int, float]) -> Array:
    """x/z, y/z (N, 1, 2) of pixels (N, 1, 2); cv2 5 moved the criteria into undistortPoints itself."""
    if hasattr(cv2, "undistortPointsIter"):
        found = cv2.undistortPointsIter(uv, matrix, distortion, np.eye(3), np.eye(3), criteria)
    else:
        found = cv2.undistortPoints(uv, matrix, distortion, criteria=criteria)  # type: ignore[call-overload]
    return np.asarray(found, dtype=np.float64)
