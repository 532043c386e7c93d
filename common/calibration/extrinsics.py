"""How two cameras stand to each other, from things that both saw at the same moment.

A bundle adjustment with fixed intrinsics: one relative pose, and one pose for each pair of pictures, which is
eliminated (as in ``adjust``). What was seen may be a board or an object with markers; the two cameras may see different
points of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import RefusedError
from common.geometry import CameraModel, Pose

Array = NDArray[np.float64]
LEAST_PAIRS = 3
_LEAST_POINTS = 4
_ITERATIONS = 40
_HUBER_PX = 2.0
_OUTLYING = 4.0
"""A pair whose rms is so many times the median pair's is left out."""
_LEAST_RMS_PX = 0.05


@dataclass(frozen=True, eq=False)
class Sight:
    """Points of a thing (N, 3), mm in its own frame, where a camera saw them (N, 2), px, and the thing's pose there."""

    points: Array
    pixels: Array
    pose: Pose


@dataclass(frozen=True, eq=False)
class Pair:
    """One thing, not moved meanwhile, in pictures of both cameras."""

    name: str
    first: Sight
    second: Sight


@dataclass(frozen=True, eq=False)
class Relative:
    """``pose``: the second camera's frame to the first one's. ``covariance`` (6, 6): of a turn after it (rad, about the
    first camera's axes) and of its translation (mm), from the corners' errors; the intrinsics' own are not in it.

    ``rms_px``: of the corners used; ``pairs`` used; ``dropped``: pairs left out since they contradict the others.
    """

    pose: Pose
    covariance: Array
    rms_px: float
    pairs: int
    dropped: tuple[str, ...]

    @property
    def sd_rotation_deg(self) -> Array:
        """Standard deviations (3,) of the turn about x, y, z of the first camera."""
        return np.degrees(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def sd_mm(self) -> Array:
        """Standard deviations (3,) of the translation."""
        return np.sqrt(np.diag(self.covariance)[3:])


def relative_pose(pairs: Sequence[Pair], first: CameraModel, second: CameraModel) -> Relative:
    """Where the second camera stands as seen from the first. Raises RefusedError for too few pairs."""
    fitted = [_Fitted(pair, first, second) for pair in pairs]
    usable = [item for item in fitted if item.usable]
    if len(usable) < LEAST_PAIRS:
        raise RefusedError(
            f"only {len(usable)} pairs of pictures show the same thing in both cameras, {LEAST_PAIRS} are needed; "
            "20 in different places are good",
            code="no_views",
        )
    pose = min((item.start for item in usable), key=lambda start: float(np.median([x.off(start) for x in usable])))
    problem = _Problem(usable, pose, huber_px=_HUBER_PX)
    problem.solve()
    rms = problem.pair_rms()
    limit = _OUTLYING * max(float(np.median(rms)), _LEAST_RMS_PX)
    kept = [item for item, one in zip(usable, rms, strict=True) if one <= limit]
    dropped = tuple(item.pair.name for item, one in zip(usable, rms, strict=True) if one > limit)
    final = _Problem(kept, problem.pose, huber_px=None)
    final.solve()
    return Relative(final.pose, final.covariance(), float(final.rms()), len(kept), dropped)


class _Fitted:
    """A pair with its rays; ``focal`` px turn differences of rays into px."""

    def __init__(self, pair: Pair, first: CameraModel, second: CameraModel) -> None:
        self.pair = pair
        self.pose = pair.second.pose
        self.points, self.rays, self.focal = [], [], []
        for sight, camera in ((pair.first, first), (pair.second, second)):
            rays = camera.normalise(sight.pixels)
            seen = np.isfinite(rays).all(axis=1)
            self.points.append(sight.points[seen])
            self.rays.append(rays[seen])
            self.focal.append(np.diag(camera.matrix)[:2])
        self.usable = all(len(points) >= _LEAST_POINTS for points in self.points)
        self.start = pair.first.pose.after(pair.second.pose.inverse())

    def off(self, relative: Pose) -> float:
        """Rms in the first picture, px, of the thing placed by the second camera and this relative pose."""
        residual, _, _ = self._side(0, relative.after(self.pair.second.pose))
        return float(np.sqrt((residual**2).sum(axis=1).mean()))

    def linearised(self, relative: Pose) -> tuple[Array, Array, Array]:
        """Residuals (N, 2) px, derivatives by the relative pose (N, 2, 6) and by the thing's pose (N, 2, 6)."""
        in_first, by_point, placed = self._side(0, relative.after(self.pose))
        turned = (placed - relative.translation) @ relative.rotation  # in the second camera
        by_relative = _moved(by_point, placed - relative.translation)
        by_own = _moved(by_point @ relative.rotation, turned - self.pose.translation)
        in_second, by_point, placed = self._side(1, self.pose)
        second = _moved(by_point, placed - self.pose.translation)
        return (
            np.concatenate([in_first, in_second]),
            np.concatenate([by_relative, np.zeros_like(second)]),
            np.concatenate([by_own, second]),
        )

    def _side(self, number: int, pose: Pose) -> tuple[Array, Array, Array]:
        """Residuals (N, 2), derivatives by the point in the camera's frame (N, 2, 3), and these points (N, 3)."""
        placed, focal = pose.apply(self.points[number]), self.focal[number]
        z = np.where(np.abs(placed[:, 2]) < 1.0, 1.0, placed[:, 2])
        residual = (self.rays[number] - placed[:, :2] / z[:, None]) * focal
        by_point = np.zeros((len(placed), 2, 3))
        by_point[:, 0, 0], by_point[:, 1, 1] = focal[0] / z, focal[1] / z
        by_point[:, :, 2] = -placed[:, :2] / z[:, None] ** 2 * focal
        return residual, by_point, placed


def _moved(by_point: Array, arms: Array) -> Array:
    """Derivatives (N, 2, 6) by a turn about the frame's axes (of ``arms`` (N, 3)) and a shift."""
    turned = np.cross(np.eye(3)[None], arms[:, None])  # (N, 3 axes, 3)
    return np.concatenate([np.einsum("nij,nkj->nik", by_point, turned), by_point], axis=2)


class _Problem:
    def __init__(self, items: Sequence[_Fitted], pose: Pose, *, huber_px: float | None) -> None:
        self.items = items
        self.pose = pose
        self._huber = huber_px

    def solve(self) -> None:
        """Levenberg-Marquardt with the things' poses eliminated."""
        damping, cost = 1e-3, self._cost()
        for _ in range(_ITERATIONS):
            step, own = self._step(damping)
            before = self.pose, [item.pose for item in self.items]
            self.pose = _turned(self.pose, step)
            for item, change in zip(self.items, own, strict=True):
                item.pose = _turned(item.pose, change)
            trial = self._cost()
            if trial <= cost:
                gain, cost, damping = (cost - trial) / max(cost, 1e-300), trial, max(damping / 8, 1e-12)
                if gain < 1e-10:
                    return
            else:
                self.pose, poses = before
                for item, pose in zip(self.items, poses, strict=True):
                    item.pose = pose
                damping *= 6

    def _blocks(self) -> list[tuple[Array, Array, Array, Array, Array]]:
        """Of each pair: shared (6, 6), mixed, own, and the scores (6,) of both."""
        out = []
        for item in self.items:
            residual, shared, own = item.linearised(self.pose)
            weight = np.sqrt(self._weights(residual))[:, None]
            a = (shared * weight[..., None]).reshape(-1, 6)
            b = (own * weight[..., None]).reshape(-1, 6)
            error = (residual * weight).ravel()
            out.append((a.T @ a, a.T @ b, b.T @ b, a.T @ error, b.T @ error))
        return out

    def _step(self, damping: float) -> tuple[Array, list[Array]]:
        left, right = np.zeros((6, 6)), np.zeros(6)
        solved: list[tuple[Array, Array]] = []
        for shared, mixed, own, score, own_score in self._blocks():
            damped = own + damping * np.diag(np.diag(own)) + 1e-12 * np.eye(6)
            both = np.asarray(np.linalg.solve(damped, np.column_stack([mixed.T, own_score])), dtype=np.float64)
            by_shared, by_score = both[:, :6], both[:, 6]
            left += shared + damping * np.diag(np.diag(shared)) - mixed @ by_shared
            right += score - mixed @ by_score
            solved.append((by_shared, by_score))
        step = np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=np.float64)
        return step, [np.asarray(by_score - by_shared @ step) for by_shared, by_score in solved]

    def _weights(self, residual: Array) -> Array:
        if self._huber is None:
            return np.ones(len(residual))
        return np.asarray(np.minimum(1.0, self._huber / np.maximum(np.linalg.norm(residual, axis=1), 1e-12)))

    def _cost(self) -> float:
        total = 0.0
        for item in self.items:
            off = np.linalg.norm(item.linearised(self.pose)[0], axis=1)
            limit = np.inf if self._huber is None else self._huber
            total += float(
                np.where(off <= limit, off**2, 2 * np.minimum(limit, 1e9) * off - min(limit, 1e9) ** 2).sum()
            )
        return total

    def pair_rms(self) -> Array:
        """Of each pair, px."""
        residuals = [item.linearised(self.pose)[0] for item in self.items]
        return np.array([np.sqrt((residual**2).sum(axis=1).mean()) for residual in residuals])

    def rms(self) -> float:
        """Of all corners, px."""
        every = np.concatenate([item.linearised(self.pose)[0] for item in self.items])
        return float(np.sqrt((every**2).sum(axis=1).mean()))

    def covariance(self) -> Array:
        """Of the relative pose, times the design effect: errors within a pair hang together (see ``uncertainty``)."""
        every = np.concatenate([item.linearised(self.pose)[0] for item in self.items])
        variance = float((every**2).sum()) / max(every.size - 6 * len(self.items) - 6, 1)
        blocks = self._blocks()
        parts = [shared - mixed @ np.linalg.solve(own, mixed.T) for shared, mixed, own, _, _ in blocks]
        inverse = np.linalg.inv(np.sum(parts, axis=0))
        scores = [score - mixed @ np.linalg.solve(own, other) for _, mixed, own, score, other in blocks]
        shares = [inverse @ part for part in parts]
        expected = sum(float(np.trace(share) - np.trace(share @ share)) for share in shares)
        found = sum(float(score @ inverse @ score) for score in scores) / max(variance, 1e-12)
        return np.asarray(inverse * variance * (max(1.0, found / expected) if expected > 0.5 else 1.0))


def _turned(pose: Pose, step: Array) -> Pose:
    turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
    return Pose(turn @ pose.rotation, pose.translation + step[3:])
