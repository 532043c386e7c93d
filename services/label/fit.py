"""Least-squares fit of a rigid pose to marker corners, in picture pixels. Pure.

Corners are undistorted once; the lens enters the residual by its slope at each corner, which is exact to
first order and the same for every camera model (pinhole with distortion, fisheye).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

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
    placed = _placed(observed, pose)
    return float("inf") if placed is None else placed.cost


def residual_px(observed: Observed, pose: Pose) -> float:
    """Root mean square distance (px) of the corners from where the pose puts them; inf behind the camera."""
    placed = _placed(observed, pose)
    if placed is None:
        return float("inf")
    residuals = _residuals_px(observed, placed)
    return math.sqrt(float(np.vdot(residuals, residuals)) / len(residuals))


def refine(observed: Observed, start: Pose, iterations: int = 30) -> Fit | None:
    """Levenberg-Marquardt from ``start``; None where it starts behind the camera or nothing finite comes out."""
    pose, placed = start, _placed(observed, start)
    if placed is None:
        return None
    damping = _FIRST_DAMPING
    jacobian = _jacobian(observed, placed)
    information, gradient = jacobian.T @ jacobian, jacobian.T @ placed.whitened
    for _ in range(iterations):
        step = _solve(information, gradient, damping)
        if step is None:
            return None
        moved = _moved(pose, step)
        ahead = _placed(observed, moved)
        gained = -math.inf if ahead is None else placed.cost - ahead.cost
        if ahead is not None and gained >= 0.0:
            settled = gained <= 1e-6 * placed.cost + 1e-12
            pose, placed, damping = moved, ahead, max(damping / 10, 1e-12)
            if settled:
                break
            jacobian = _jacobian(observed, placed)
            information, gradient = jacobian.T @ jacobian, jacobian.T @ placed.whitened
        elif damping > 1e8 or gained > -1e-9 * placed.cost:  # no step leads on, or only its rounding speaks against it
            break
        else:
            damping = max(damping * 10, _REFUSED_DAMPING)
    if not (math.isfinite(placed.cost) and pose.finite):
        return None
    return Fit(pose, placed.cost, _residuals_px(observed, placed), information)


def square_poses(rays: Array, size_mm: float) -> tuple[Pose, ...]:
    """Both poses (marker to camera frame) of a square marker from its corners' rays (4, 2), better one first.

    Method: infinitesimal plane-based pose estimation for squares (Collins and Bartoli, IJCV 2014), cv2's.
    """
    if not np.isfinite(rays).all():
        return ()
    half = size_mm / 2
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    try:
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(square, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    except cv2.error:  # corners on one line have no homography: a degenerate quadrilateral, not a marker
        return ()
    found = (Pose.from_rvec(rvec, tvec) for rvec, tvec in zip(rvecs, tvecs, strict=True))
    return tuple(pose for pose in found if pose.finite and pose.translation[2] > NEAR_MM)


class _Placed(NamedTuple):
    """The points under a pose: ``turned`` (N, 3) about the object's origin, ``depth`` (N,), ``rays`` (N, 2)."""

    turned: Array
    depth: Array
    rays: Array
    off: Array
    whitened: Array
    cost: float


def _placed(observed: Observed, pose: Pose) -> _Placed | None:
    """None where a point would lie behind the camera."""
    turned = observed.points @ pose.rotation.T
    xyz = turned + pose.translation
    depth = xyz[:, 2]
    if not depth.min() > NEAR_MM:  # also for NaN
        return None
    rays = xyz[:, :2] / xyz[:, 2:]
    off = rays - observed.rays
    whitened = observed.weighing @ off.ravel()
    return _Placed(turned, depth, rays, off, whitened, float(whitened @ whitened))


def _residuals_px(observed: Observed, placed: _Placed) -> Array:
    return np.asarray((observed.slopes @ placed.off[:, :, None])[:, :, 0])


def _jacobian(observed: Observed, placed: _Placed) -> Array:
    """d residual / d (rotation in the camera frame about the object's origin, shift), (2N, 6), whitened.

    Of a ray u = x/z, v = y/z: the rows of d (x, y, z) / d rotation are those of ``turn_columns``.
    """
    x, y, z = placed.turned.T
    u, v = placed.rays.T
    ray = np.zeros((len(z), 2, 6))
    ray[:, 0, 0] = -u * y
    ray[:, 0, 1] = z + u * x
    ray[:, 0, 2] = -y
    ray[:, 0, 3] = 1.0
    ray[:, 1, 0] = -z - v * y
    ray[:, 1, 1] = v * x
    ray[:, 1, 2] = x
    ray[:, 1, 4] = 1.0
    ray[:, :, 5] = -placed.rays
    ray /= placed.depth[:, None, None]
    return np.asarray(observed.weighing @ ray.reshape(-1, 6))


def turn_columns(turned: Array) -> Array:
    """d point / d rotation vector (N, 3, 3) of points that were turned about the origin (N, 3)."""
    cross = np.zeros((len(turned), 3, 3))
    x, y, z = turned.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = z, -y, x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = -z, y, -x
    return cross


def _solve(information: Array, gradient: Array, damping: float) -> Array | None:
    damped = information.copy()
    damped.reshape(-1)[::7] *= 1.0 + damping
    solved, found = cv2.solve(damped, -gradient[:, None])  # OpenCV 5 takes no vector
    if not solved:
        return None
    step: Array = np.asarray(found, dtype=np.float64).ravel()
    return step if math.isfinite(float(step @ step)) else None


def covariance_of(information: Array) -> Array:
    """The inverse of ``information`` (6, 6) of a rotation (rad) and a shift (mm), or of fewer such parameters."""
    # Radians and millimetres differ by orders of magnitude: scaled first, for the inverse's digits.
    scale = 1.0 / np.sqrt(np.maximum(information.diagonal(), 1e-12))
    scales = scale[:, None] * scale
    try:
        inverse = np.linalg.inv(information * scales)
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(information * scales, hermitian=True)
    return np.asarray(inverse * scales)


def _moved(pose: Pose, step: Array) -> Pose:
    turn, _ = cv2.Rodrigues(step[:3])
    return Pose(np.asarray(turn, dtype=np.float64) @ pose.rotation, pose.translation + step[3:])


def _lens_slopes(rays: Array, camera: CameraModel) -> Array:
    """d pixel / d ray (N, 2, 2)."""
    if camera.straight:
        return np.tile(camera.matrix[:2, :2] * np.eye(2), (len(rays), 1, 1))
    offsets = np.array([[_STEP, 0], [-_STEP, 0], [0, _STEP], [0, -_STEP]])
    around = (rays[:, None, :] + offsets).reshape(-1, 2)
    pixels, _ = camera.project(np.column_stack([around, np.ones(len(around))]))
    shifted = pixels.reshape(-1, 4, 2)
    right = (shifted[:, 0] - shifted[:, 1]) / (2 * _STEP)
    down = (shifted[:, 2] - shifted[:, 3]) / (2 * _STEP)
    return np.stack([right, down], axis=2)
