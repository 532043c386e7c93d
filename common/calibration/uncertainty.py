"""How sure a calibration is: standard deviations of its parameters, and of where a point in the room is projected.

The covariance of the shared parameters is the inverse of the normal equations with all poses eliminated, times the
residuals' variance. Two things make the plain formula too small, and are accounted for: the board's warp is a parameter
of its own, and corner errors within a picture hang together (blur, shadows, a board bent otherwise than modelled). The
second shows in the views' scores being larger than independent errors allow; the covariance is multiplied by that
ratio, the *design effect* of sampling in clusters (Kish, "Survey Sampling", 1965; Liang and Zeger, "Longitudinal data
analysis using generalized linear models", Biometrika 73, 1986, of which this is the scalar form).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """``covariance`` (k + 2, k + 2) of theta and warp; ``design_effect``: what it was multiplied by (1 or more)."""

    covariance: Array
    design_effect: float

    @property
    def sd(self) -> Array:
        """Standard deviations (k + 2) of theta and the two warps."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, eq=False)
class UncertaintyMap:
    """Standard deviation ``sd_px`` (rows, columns) of a projected point ``distance_mm`` away, in its worst direction.

    ``x`` (columns,) and ``y`` (rows,): the pixels. NaN where no ray leads to a pixel.
    """

    distance_mm: float
    x: Array
    y: Array
    sd_px: Array

    @property
    def worst_px(self) -> float:
        """Greatest value in the picture; infinite where the model has none at all."""
        return float(np.nanmax(self.sd_px)) if np.isfinite(self.sd_px).any() else float("inf")

    @property
    def worst_place(self) -> str:
        """Where in the picture that is, in words."""
        rows, columns = self.sd_px.shape
        filled = np.where(np.isfinite(self.sd_px), self.sd_px, np.inf)
        row, column = divmod(int(np.argmax(filled)), columns)
        vertical = ("upper", "", "lower")[3 * row // rows]
        horizontal = ("left", "", "right")[3 * column // columns]
        return " ".join(word for word in (vertical, horizontal) if word) or "middle"

    @property
    def centre_px(self) -> float:
        """In the middle of the picture."""
        rows, columns = self.sd_px.shape
        return float(self.sd_px[rows // 2, columns // 2])


def uncertainty(fit: Adjusted) -> Uncertainty:
    """Covariance of the shared parameters."""
    parts = _information(fit)
    total = parts.sum(axis=0) + np.diag(fit.prior)
    inverse = np.linalg.inv(total)
    effect = _design_effect(fit, parts, inverse)
    return Uncertainty(inverse * (fit.variance * effect), effect)


def _information(fit: Adjusted) -> Array:
    """What each view says about the shared parameters once its pose is eliminated, (n, k, k)."""
    blocks = fit.blocks
    solved = np.linalg.solve(blocks.own + 1e-12 * np.eye(6), blocks.mixed.transpose(0, 2, 1))
    return np.asarray(blocks.shared - blocks.mixed @ solved)


def _design_effect(fit: Adjusted, parts: Array, inverse: Array) -> float:
    """The views' squared scores over what independent errors of the same variance would give; at least 1."""
    shares = inverse @ parts
    expected = float(np.trace(shares, axis1=1, axis2=2).sum() - np.einsum("nab,nba->", shares, shares))
    if expected <= 0.5 or fit.variance <= 0:
        return 1.0
    found = float(np.einsum("na,ab,nb->", fit.blocks.score, inverse, fit.blocks.score)) / fit.variance
    return max(1.0, found / expected)


def projection_map(
    fit: Adjusted, known: Uncertainty, size: tuple[int, int], distance_mm: float, *, columns: int = 17, rows: int = 11
) -> UncertaintyMap:
    """The uncertainty of projection over the picture at one distance along the ray.

    A point is taken as fixed to the boards of all views, each of which has its own uncertain pose; their mean carries
    it back before the camera: the "mean-pcam" method of mrcal's documentation (Kogan, "Projection uncertainty"). So a
    turn of the camera that the poses make up for is no error, and the result grows away from where boards were seen.
    """
    camera = fit.lens.camera(fit.theta, size)
    x, y = np.linspace(0, size[0] - 1, columns), np.linspace(0, size[1] - 1, rows)
    rays = camera.normalise(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    seen = np.isfinite(rays).all(axis=1)
    sd = np.full(len(rays), np.nan)
    if seen.any():
        along = np.column_stack([rays[seen], np.ones(int(seen.sum()))])
        points = along / np.linalg.norm(along, axis=1, keepdims=True) * distance_mm
        sd[seen] = _projected_sd(fit, known, points)
    return UncertaintyMap(distance_mm, x, y, sd.reshape(rows, columns))


def _projected_sd(fit: Adjusted, known: Uncertainty, points: Array) -> Array:
    blocks, count = fit.blocks, len(fit.poses)
    _, by_theta, _, by_point = fit.lens.project(fit.theta, np.zeros(6), points)
    variance = fit.variance * known.design_effect
    by_shared = np.zeros((len(points), 3, blocks.shared.shape[1]))
    own = np.zeros((len(points), 3, 3))
    for view in range(count):
        moved = _moved_by_pose(fit.poses[view], points)
        inverse = np.linalg.inv(blocks.own[view] + 1e-12 * np.eye(6))
        by_shared -= moved @ (inverse @ blocks.mixed[view].T) / count
        own += moved @ inverse @ moved.transpose(0, 2, 1) * (variance / count**2)
    gradient = by_point @ by_shared
    gradient[:, :, : by_theta.shape[2]] += by_theta
    spread = gradient @ known.covariance @ gradient.transpose(0, 2, 1)
    spread += by_point @ own @ by_point.transpose(0, 2, 1)
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, -1], 0.0)))


def _moved_by_pose(pose: Array, points: Array) -> Array:
    """How points (N, 3), in the camera's frame but fixed to a board, move with the board's pose: (N, 3, 6)."""
    rotation, jacobian = cv2.Rodrigues(pose[:3])
    fixed = (points - pose[3:]) @ np.asarray(rotation)
    turned = np.asarray(jacobian, dtype=np.float64).reshape(3, 3, 3)  # by r_k, then the matrix row by row
    by_turn = np.einsum("kab,nb->nak", turned, fixed)
    return np.concatenate([by_turn, np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)
