"""Bundle adjustment of one camera: intrinsics, the board's warp and each view's pose, with their normal equations.

Levenberg-Marquardt with the poses eliminated view by view (Schur complement: Triggs et al., "Bundle Adjustment - A
Modern Synthesis", 2000, section 6). cv2.calibrateCamera does the same without warp, weights and the blocks from which
the uncertainties follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.calibration.lens import CORE, Lens
from common.calibration.views import View

Array = NDArray[np.float64]
WARP_SD = 0.003
"""Prior of a board's deflection as a share of its longer side: boards are meant to be flat."""
_FOCAL_SD, _CENTRE_SD, _DISTORTION_SD = 1.0, 0.5, 30.0
"""Priors so wide (of the focal length, of the picture's size, absolute) that they decide nothing but what the views
leave entirely open; without them a hopeless set has no covariance at all instead of a huge one."""
_ITERATIONS = 60
_CONVERGED = 1e-9


@dataclass(frozen=True, eq=False)
class Blocks:
    """The normal equations at the solution; shared parameters s = theta and warp, view i's pose.

    ``shared`` (n, k, k), ``own`` (n, 6, 6), ``mixed`` (n, k, 6): sums of products of derivatives, ``score`` (n, k):
    of shared derivatives and residuals.
    """

    shared: Array
    own: Array
    mixed: Array
    score: Array
    own_score: Array


@dataclass(frozen=True, eq=False)
class Adjusted:
    """``theta`` (k), ``warp`` (2) mm, ``poses`` (n, 6), ``residuals``: per view (N, 2) px, observed minus projected."""

    lens: Lens
    theta: Array
    warp: Array
    poses: Array
    residuals: tuple[Array, ...]
    blocks: Blocks
    prior: Array
    """Diagonal (k + 2) of the prior's precision, in units of the residuals' variance."""

    @property
    def count(self) -> int:
        """How many corners there are."""
        return sum(len(residual) for residual in self.residuals)

    @property
    def rms(self) -> float:
        """Root mean square of the corners' distances, px (cv2's definition)."""
        return float(np.sqrt(sum(float((residual**2).sum()) for residual in self.residuals) / max(self.count, 1)))

    @property
    def view_rms(self) -> Array:
        """The same for each view (n,)."""
        return np.array([np.sqrt((residual**2).sum(axis=1).mean()) for residual in self.residuals])

    @property
    def variance(self) -> float:
        """Variance of one coordinate of one corner, px^2, by the residuals' degrees of freedom."""
        total = sum(float((residual**2).sum()) for residual in self.residuals)
        unknowns = len(self.theta) + (len(self.warp) if self.warp.any() else 0) + self.poses.size
        return total / max(2 * self.count - unknowns, 1)


def warp_shape(points: Array, extent: Array) -> Array:
    """How two unit deflections (along x, along y) move points (N, 3) along the board's normal: (N, 2).

    A paraboloid 1 - u^2 with u = -1 ... 1 over the board (``extent``: (2, 2), least and greatest x and y), as mrcal
    models board deformation.
    """
    middle, half = extent.mean(axis=0), np.maximum((extent[1] - extent[0]) / 2, 1e-9)
    return np.asarray(1 - ((points[:, :2] - middle) / half) ** 2)


def board_extent(views: Sequence[View]) -> Array:
    """Least and greatest x and y (2, 2) of all points in the views."""
    points = np.concatenate([view.points[:, :2] for view in views])
    return np.array([points.min(axis=0), points.max(axis=0)])


def adjust(
    views: Sequence[View],
    lens: Lens,
    theta: Array,
    poses: Array,
    *,
    warp: Array | None = None,
    flat: bool = False,
    fixed: bool = False,
    huber_px: float | None = None,
    sigma_px: float = 0.3,
    iterations: int = _ITERATIONS,
    extent: Array | None = None,
) -> Adjusted:
    """Fit the camera to the views, from a start.

    ``flat``: the board has no warp; ``fixed``: theta and warp stay, only poses are fitted. ``huber_px``: corners
    further off count less. ``sigma_px``: expected error of a coordinate, against which the priors are weighed.
    """
    problem = _Problem(views, lens, board_extent(views) if extent is None else extent, huber_px, flat=flat, fixed=fixed)
    state = _State(theta.copy(), np.zeros(2) if warp is None else warp.copy(), poses.copy())
    prior = problem.prior(sigma_px)
    damping = 1e-3
    blocks, cost, residuals = problem.linearised(state, prior)
    for _ in range(iterations):
        step = problem.step(blocks, state, prior, damping)
        trial = state.moved(*step)
        trial_blocks, trial_cost, trial_residuals = problem.linearised(trial, prior)
        if np.isfinite(trial_cost) and trial_cost <= cost:
            gain = (cost - trial_cost) / max(cost, 1e-300)
            state, blocks, cost, residuals = trial, trial_blocks, trial_cost, trial_residuals
            damping = max(damping / 8, 1e-12)
            if gain < _CONVERGED:
                break
        else:
            damping *= 6
            if damping > 1e9:
                break
    return Adjusted(lens, state.theta, state.warp, state.poses, residuals, blocks, prior)


@dataclass(frozen=True, eq=False)
class _State:
    theta: Array
    warp: Array
    poses: Array

    def moved(self, shared: Array, own: Array) -> _State:
        size = len(self.theta)
        return _State(self.theta + shared[:size], self.warp + shared[size:], self.poses + own)


class _Problem:
    def __init__(
        self, views: Sequence[View], lens: Lens, extent: Array, huber_px: float | None, *, flat: bool, fixed: bool
    ) -> None:
        self._views = views
        self._lens = lens
        self._shapes = [warp_shape(view.points, extent) for view in views]
        self._longest = float((extent[1] - extent[0]).max())
        self._huber = huber_px
        size = CORE + len(lens.free) + 2
        self._free = np.zeros(size, dtype=bool) if fixed else np.ones(size, dtype=bool)
        if flat:
            self._free[-2:] = False
        self._width = max(view.size[0] for view in views)

    def prior(self, sigma_px: float) -> Array:
        spread = np.full(len(self._free), _DISTORTION_SD)
        spread[:2] = _FOCAL_SD * self._width
        spread[2:CORE] = _CENTRE_SD * self._width
        spread[-2:] = WARP_SD * self._longest
        return np.asarray(sigma_px**2 / spread**2)

    def linearised(self, state: _State, prior: Array) -> tuple[Blocks, float, tuple[Array, ...]]:
        count, size = len(self._views), len(self._free)
        shared, own = np.zeros((count, size, size)), np.zeros((count, 6, 6))
        mixed, score, own_score = np.zeros((count, size, 6)), np.zeros((count, size)), np.zeros((count, 6))
        cost, residuals = 0.0, []
        for number, (view, shape) in enumerate(zip(self._views, self._shapes, strict=True)):
            points = view.points.copy()
            points[:, 2] += shape @ state.warp
            pose = state.poses[number]
            pixels, by_theta, by_pose, by_point = self._lens.project(state.theta, pose, points)
            by_warp = (by_point @ _rotation(pose)[:, 2])[:, :, None] * shape[:, None, :]
            residual = view.corners - pixels
            weights = self._weights(residual)
            cost += float((weights[:, None] ** 2 * residual**2).sum()) if self._huber is None else self._loss(residual)
            first = (np.concatenate([by_theta, by_warp], axis=2) * weights[:, None, None]).reshape(-1, size)
            second = (by_pose * weights[:, None, None]).reshape(-1, 6)
            error = (residual * weights[:, None]).ravel()
            shared[number], own[number], mixed[number] = first.T @ first, second.T @ second, first.T @ second
            score[number], own_score[number] = first.T @ error, second.T @ error
            residuals.append(residual)
        cost += float((prior[-2:] * state.warp**2).sum())
        return Blocks(shared, own, mixed, score, own_score), cost, tuple(residuals)

    def step(self, blocks: Blocks, state: _State, prior: Array, damping: float) -> tuple[Array, Array]:
        """Damped Gauss-Newton step of the shared parameters and of the poses."""
        own = blocks.own + damping * blocks.own * np.eye(6) + 1e-12 * np.eye(6)
        reduced = np.linalg.solve(
            own, np.concatenate([blocks.mixed.transpose(0, 2, 1), blocks.own_score[:, :, None]], 2)
        )
        by_shared, by_score = reduced[:, :, :-1], reduced[:, :, -1]
        total = blocks.shared.sum(axis=0)
        pull = np.zeros(len(prior))
        pull[-2:] = -prior[-2:] * state.warp
        left = (
            total
            + np.diag(prior)
            + damping * np.diag(np.diag(total))
            - np.einsum("nab,nbc->ac", blocks.mixed, by_shared)
        )
        right = blocks.score.sum(axis=0) + pull - np.einsum("nab,nb->a", blocks.mixed, by_score)
        shared = np.zeros(len(prior))
        free = self._free
        if free.any():
            shared[free] = np.linalg.lstsq(left[np.ix_(free, free)], right[free], rcond=None)[0]
        return shared, np.asarray(by_score - by_shared @ shared)

    def _weights(self, residual: Array) -> Array:
        if self._huber is None:
            return np.ones(len(residual))
        length = np.maximum(np.linalg.norm(residual, axis=1), 1e-12)
        return np.asarray(np.sqrt(np.minimum(1.0, self._huber / length)))

    def _loss(self, residual: Array) -> float:
        length = np.linalg.norm(residual, axis=1)
        limit = self._huber or 0.0
        return float(np.where(length <= limit, length**2, 2 * limit * length - limit**2).sum())


def _rotation(pose: Array) -> Array:
    return np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)
