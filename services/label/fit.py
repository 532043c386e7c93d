"""Least-squares fit of a rigid pose to marker corners, in picture pixels. Pure.

Corners are undistorted once; the lens enters the residual by its slope at each corner, which is exact to
first order and the same for every camera model (pinhole with distortion, fisheye).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel, Pose

Array = NDArray[np.float64]

NEAR_MM = 1.0
"""No point of a fit may come nearer to the camera's plane."""
_FIRST_DAMPING = 1e-5
"""Starts are good: nearly a Gauss-Newton step, at once."""
_REFUSED_DAMPING = 1e-3
"""Where such a step leads uphill, less damping than this changes nothing."""
_STEP = 1e-4
"""Step (x/z units) of the lens slope's central differences."""


@dataclass(frozen=True, eq=False)
class Observed:
    """Corners as seen: ``points`` (N, 3) mm in the object frame, ``rays`` (N, 2) undistorted x/z, y/z,
    ``slopes`` (N, 2, 2) d pixel / d ray of the lens, ``sigma`` (N,) px.

    ``whitening`` (2N, 2N) turns residuals x y x y ... (px) into independent ones of unit variance, ``weighing``
    (2N, 2N) those of the rays.
    """

    points: Array
    rays: Array
    slopes: Array
    sigma: Array
    whitening: Array
    weighing: Array = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.points)
        by_corner = self.whitening.reshape(-1, count, 1, 2) @ self.slopes
        object.__setattr__(self, "weighing", by_corner.reshape(-1, 2 * count))

    @property
    def finite(self) -> bool:
        """Whether every corner has a ray (a lens need not reach every pixel)."""
        return bool(np.isfinite(self.rays).all() and np.isfinite(self.slopes).all())


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose (object to camera frame) and how it fits.

    ``cost`` is the sum of squared residuals in units of the corner noise, ``residuals`` (N, 2) are px,
    ``information`` (6, 6) is the inverse covariance of a rotation (rad) and a shift (mm) in the camera frame.
    """

    pose: Pose
    cost: float
    residuals: Array
    information: Array


def observe(
    points: Array, pixels: Array, sigma: Array, camera: CameraModel, covariance: Array | None = None
) -> Observed:
    """Prepare corners: ``points`` (N, 3) mm, ``pixels`` (N, 2), ``sigma`` (N,) px.

    ``covariance`` (2N, 2N) px^2 of x y x y ...; None: independent corners of ``sigma``.
    """
    rays = camera.normalise(pixels)
    if covariance is None:
        whitening = np.diag(np.repeat(1.0 / sigma, 2))
    else:
        whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
    return Observed(points, rays, _lens_slopes(rays, camera), sigma, whitening)


def join(parts: Sequence[Observed]) -> Observed:
    """Corners of several markers as one observation; one marker's errors say nothing about another's."""
    if len(parts) == 1:
        return parts[0]
    sigma = np.concatenate([part.sigma for part in parts])
    whitening = np.zeros((2 * len(sigma), 2 * len(sigma)))
    at = 0
    for part in parts:
        size = len(part.whitening)
        whitening[at : at + size, at : at + size] = part.whitening
        at += size
    return Observed(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.rays for part in parts]),
        np.concatenate([part.slopes for part in parts]),
        sigma,
        whitening,
    )


def misfit(observed: Observed, pose: Pose) -> float:
    """The cost of a pose; infinite where a point would lie behind the camera."""
    off = _off(observed, pose)
    return float("inf") if off is None else _cost(observed.weighing @ off.ravel())


def residual_px(observed: Observed, pose: Pose) -> float:
    """Root mean square distance (px) of the corners from where the pose puts them; inf behind the camera."""
    off = _off(observed, pose)
    return float("inf") if off is None else float(np.sqrt((_in_pixels(observed, off) ** 2).sum(axis=1).mean()))


def refine(observed: Observed, start: Pose, iterations: int = 30) -> Fit | None:
    """Levenberg-Marquardt from ``start``; None where it starts behind the camera or nothing finite comes out."""
    pose, off = start, _off(observed, start)
    if off is None:
        return None
    white = observed.weighing @ off.ravel()
    cost, damping = _cost(white), _FIRST_DAMPING
    jacobian = _jacobian(observed, pose)
    information, gradient = jacobian.T @ jacobian, jacobian.T @ white
    for _ in range(iterations):
        step = _solve(information, gradient, damping)
        if step is None:
            return None
        moved = _moved(pose, step)
        next_off = _off(observed, moved)
        if next_off is not None:
            white = observed.weighing @ next_off.ravel()
        next_cost = float("inf") if next_off is None else _cost(white)
        if next_off is not None and next_cost <= cost:
            settled = cost - next_cost <= 1e-6 * cost + 1e-12
            pose, off, cost, damping = moved, next_off, next_cost, max(damping / 10, 1e-12)
            if settled:
                break
            jacobian = _jacobian(observed, pose)
            information, gradient = jacobian.T @ jacobian, jacobian.T @ white
        elif damping > 1e8:
            break
        else:
            damping = max(damping * 10, _REFUSED_DAMPING)
    if not (np.isfinite(cost) and np.isfinite(pose.matrix).all()):
        return None
    return Fit(pose, cost, _in_pixels(observed, off), information)


def square_poses(corners: Array, size_mm: float, camera: CameraModel) -> tuple[Pose, ...]:
    """Both poses (marker to camera frame) of a square marker from its corners (4, 2) px, better one first.

    Method: infinitesimal plane-based pose estimation for squares (Collins and Bartoli, IJCV 2014), cv2's.
    """
    rays = camera.normalise(corners)
    if not np.isfinite(rays).all():
        return ()
    half = size_mm / 2
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    try:
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(square, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:  # corners on one line have no homography: a degenerate quadrilateral, not a marker
        return ()
    found = (Pose.from_rvec(rvec, tvec) for rvec, tvec in zip(rvecs, tvecs, strict=True))
    return tuple(pose for pose in found if np.isfinite(pose.matrix).all() and pose.translation[2] > NEAR_MM)


def _off(observed: Observed, pose: Pose) -> Array | None:
    """The rays (N, 2) of a pose's corners minus those that were seen; None behind the camera."""
    xyz = pose.apply(observed.points)
    if not (xyz[:, 2] > NEAR_MM).all():  # also false for NaN
        return None
    return np.asarray(xyz[:, :2] / xyz[:, 2:] - observed.rays)


def _in_pixels(observed: Observed, off: Array) -> Array:
    return np.asarray((observed.slopes @ off[:, :, None])[:, :, 0])


def _cost(white: Array) -> float:
    return float(white @ white)


def _jacobian(observed: Observed, pose: Pose) -> Array:
    """d residual / d (rotation in the camera frame about the object's origin, shift), (2N, 6), whitened."""
    turned = observed.points @ pose.rotation.T
    xyz = turned + pose.translation
    inverse_z = 1.0 / xyz[:, 2]
    count = len(xyz)
    ray = np.zeros((count, 2, 3))
    ray[:, 0, 0] = ray[:, 1, 1] = inverse_z
    ray[:, :, 2] = -xyz[:, :2] * (inverse_z**2)[:, None]
    plain = np.concatenate([ray @ turn_columns(turned), ray], axis=2).reshape(2 * count, 6)
    return np.asarray(observed.weighing @ plain)


def turn_columns(turned: Array) -> Array:
    """d point / d rotation vector (N, 3, 3) of points that were turned about the origin (N, 3)."""
    cross = np.zeros((len(turned), 3, 3))
    x, y, z = turned.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = z, -y, x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = -z, y, -x
    return cross


def _solve(information: Array, gradient: Array, damping: float) -> Array | None:
    damped = information.copy()
    damped.flat[::7] *= 1.0 + damping
    solved, step = cv2.solve(damped, -gradient, flags=cv2.DECOMP_LU)
    return np.asarray(step, dtype=np.float64).ravel() if solved and np.isfinite(step).all() else None


def _moved(pose: Pose, step: Array) -> Pose:
    turn, _ = cv2.Rodrigues(step[:3])
    return Pose(np.asarray(turn, dtype=np.float64) @ pose.rotation, pose.translation + step[3:])


def _lens_slopes(rays: Array, camera: CameraModel) -> Array:
    offsets = np.array([[_STEP, 0], [-_STEP, 0], [0, _STEP], [0, -_STEP]])
    around = (rays[:, None, :] + offsets).reshape(-1, 2)
    pixels, _ = camera.project(np.column_stack([around, np.ones(len(around))]))
    shifted = pixels.reshape(-1, 4, 2)
    right = (shifted[:, 0] - shifted[:, 1]) / (2 * _STEP)
    down = (shifted[:, 2] - shifted[:, 3]) / (2 * _STEP)
    return np.stack([right, down], axis=2)
