"""Lens models that a calibration chooses among, as a vector of free parameters with its derivatives.

Each comes down to cv2's own projection: ``2``, ``5`` and ``8`` are its pinhole with 2 radial, 5 and 8 (rational)
coefficients, ``fisheye`` is cv2.fisheye's four (Kannala and Brandt 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel

Array = NDArray[np.float64]
LensName = Literal["2", "5", "8", "fisheye"]
CORE = 4
"""fx, fy, cx, cy come first in the vector of parameters."""


@dataclass(frozen=True)
class Lens:
    """``free``: which of cv2's ``length`` distortion coefficients are estimated, the others stay 0."""

    name: str
    words: str
    free: tuple[int, ...]
    length: int
    names: tuple[str, ...]
    fisheye: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the vector's entries."""
        return ("fx", "fy", "cx", "cy", *self.names)

    def distortion(self, theta: Array) -> Array:
        """cv2's distortion vector (length,)."""
        out = np.zeros(self.length)
        out[list(self.free)] = theta[CORE:]
        return out

    def camera(self, theta: Array, size: tuple[int, int]) -> CameraModel:
        """The camera with these parameters, for pictures of ``size`` (width, height)."""
        fx, fy, cx, cy = theta[:CORE]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        return CameraModel(*size, matrix, self.distortion(theta), model="fisheye" if self.fisheye else "pinhole")

    def from_other(self, other: Lens, theta: Array) -> Array:
        """The nearest start for this lens from another one's parameters; another projection starts undistorted."""
        out = np.zeros(CORE + len(self.free))
        out[:CORE] = theta[:CORE]
        if other.fisheye == self.fisheye:
            for number, index in enumerate(self.free):
                if index in other.free:
                    out[CORE + number] = theta[CORE + other.free.index(index)]
        return out

    def project(self, theta: Array, pose: Array, points: Array) -> tuple[Array, Array, Array, Array]:
        """Pixels (N, 2) of points (N, 3, mm) under a pose (6: Rodrigues vector, translation), and their derivatives.

        By theta (N, 2, k), by the pose (N, 2, 6), by the point in the camera's frame (N, 2, 3).
        """
        fx, fy, cx, cy = theta[:CORE]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        distortion = self.distortion(theta)
        count = len(points)
        if self.fisheye:
            pixels, found = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), pose[:3], pose[3:], matrix, distortion)
            jacobian = np.asarray(found, dtype=np.float64).reshape(count, 2, -1)
            core, coefficients, own = jacobian[:, :, :4], jacobian[:, :, 4:8], jacobian[:, :, 8:14]
        else:
            pixels, found = cv2.projectPoints(points, pose[:3], pose[3:], matrix, distortion)
            jacobian = np.asarray(found, dtype=np.float64).reshape(count, 2, -1)
            own, core, coefficients = jacobian[:, :, :6], jacobian[:, :, 6:10], jacobian[:, :, 10:]
        by_theta = np.concatenate([core, coefficients[:, :, list(self.free)]], axis=2)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), by_theta, own, own[:, :, 3:]


LENSES: dict[str, Lens] = {
    "2": Lens("2", "pinhole, 2 radial coefficients", (0, 1), 5, ("k1", "k2")),
    "5": Lens("5", "pinhole, 5 coefficients", (0, 1, 2, 3, 4), 5, ("k1", "k2", "p1", "p2", "k3")),
    "8": Lens("8", "pinhole, 8 coefficients (rational)", tuple(range(8)), 8,
              ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "fisheye": Lens("fisheye", "fisheye, 4 coefficients", (0, 1, 2, 3), 4, ("k1", "k2", "k3", "k4"), fisheye=True),
}  # fmt: skip
"""In the order of their freedom: of two that predict equally well the earlier is taken."""
PLAIN = Lens("plain", "pinhole without distortion", (), 5, ())
"""Only to begin with."""
EVEN = Lens("even", "fisheye without further terms", (), 4, (), fisheye=True)
