"""How far a pose may be off: the corner noise carried through the joint pose to distance, rotation and corners. Pure.

Where the poses that fit don't form one narrow bell, the bar covers them all: the fit's other minima count by their
odds, and a lone side seen nearly squarely, whose two mirrored minima run into each other, is sampled tilt by tilt.
Only the noise of the corners counts: neither the calibration's error nor that of the sizes in the rig file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, CameraModel, Pose
from common.labels import Uncertainty
from services.label.fit import NEAR_MM, Observed, covariance_of, turn_columns
from services.label.pose import BoxPose

Array = NDArray[np.float64]

_STEP_RAD, _STEP_MM = 1e-5, 1e-2
APART = 4.0
"""Two mirrored minima that lie this many sigma from where they would meet don't run into each other."""
GRID = 17
"""Tilts sampled each way where they do."""
LARGEST_TILT = np.radians(75.0)
_TELLING = 18.0
"""Tilts whose cost is higher by this than the best one's don't count."""
_NEGLIGIBLE = 1e-4
"""Tilts of less weight are left out."""
SPANNED = 0.25
"""The least weight of a second pose that nothing decides against: two sigma then reach it."""
DISPUTED_ODDS = 0.5
"""Of the pose without one of the markers that disagree, against the joint one: of two, either is within two sigma."""


@dataclass(frozen=True, eq=False)
class Spread:
    """What a pose may be instead: a bell of ``covariance`` (6, 6) around each of ``others``, which have weights.

    The covariance is of a rotation (rad) about the object's origin and a shift (mm) in the camera frame. The
    weights add up to at most 1; the rest is the pose itself.
    """

    covariance: Array
    others: tuple[tuple[Pose, float], ...] = ()


def uncertainty(box: Box, found: BoxPose, camera: CameraModel) -> Uncertainty:
    """One sigma of a pose (root mean square of the error to expect)."""
    return of_spread(box, found.pose, spread_of(found), camera)


def quick_uncertainty(box: Box, found: BoxPose, camera: CameraModel) -> Uncertainty:
    """The same for a live label: from the detector's corners, and without sampling a lone side's tilts."""
    return of_spread(box, found.pose, spread_of(found, tilts=False), camera)


def spread_of(found: BoxPose, *, tilts: bool = True) -> Spread:
    """The poses that fit a box's markers as well as the noise allows; without ``tilts`` faster, but just the bells.

    Where the markers disagree, one of them is wrong, and what the pose is without it counts too.
    """
    spread = _spread_of(found, tilts=tilts)
    if not found.disputed:
        return spread
    share = 1.0 / (1.0 + 1.0 / (DISPUTED_ODDS * len(found.disputed)))
    others = [(pose, weight * (1.0 - share)) for pose, weight in spread.others]
    others += [(pose, share / len(found.disputed)) for pose in found.disputed]
    return Spread(spread.covariance, tuple(others))


def _spread_of(found: BoxPose, *, tilts: bool) -> Spread:
    covariance = found.covariance
    sides = {fit.seen.side.face for fit in found.markers}
    if tilts and len(sides) == 1:
        normal = np.array(FACES[next(iter(sides))].normal, dtype=np.float64)
        tilted = _sampled_tilts(found, normal, covariance)
        if tilted is not None:
            return tilted
    total = 1.0 + sum(odds for _, odds in found.rivals)
    least = SPANNED if found.ambiguous else 0.0
    others = tuple(
        (pose, max(odds / total, least if pose is found.alternative else 0.0)) for pose, odds in found.rivals
    )
    return Spread(covariance, others)


def of_spread(box: Box, pose: Pose, spread: Spread, camera: CameraModel) -> Uncertainty:
    """Distance (mm), rotation (deg) and corners (px), one sigma; a corner behind the camera has None."""
    covariance = spread.covariance
    away = pose.translation / max(float(np.linalg.norm(pose.translation)), 1e-9)
    distance = float(away @ covariance[3:, 3:] @ away)
    rotation = float(np.trace(covariance[:3, :3]))
    pixels, _ = camera.project(pose.apply(box.corners))
    slopes = _corner_slopes(box, pose, camera)
    corners = np.einsum("nai,ij,naj->n", slopes, covariance, slopes)
    if spread.others:
        weights = np.array([weight for _, weight in spread.others])
        lengths = np.array([np.linalg.norm(other.translation) for other, _ in spread.others])
        distance += float(weights @ (lengths - np.linalg.norm(pose.translation)) ** 2)
        rotation += float(weights @ np.array([pose.angle_to(other) ** 2 for other, _ in spread.others]))
        placed, _ = camera.project(np.concatenate([other.apply(box.corners) for other, _ in spread.others]))
        apart = ((placed.reshape(len(weights), -1, 2) - pixels) ** 2).sum(axis=2)
        corners += weights @ np.where(np.isfinite(apart), apart, 0.0)
    return Uncertainty(
        distance_mm=float(np.sqrt(distance)),
        rotation_deg=float(np.degrees(min(np.sqrt(rotation), np.pi))),
        corners_px=tuple(float(np.sqrt(value)) if np.isfinite(value) else None for value in corners),
    )


def _corner_slopes(box: Box, pose: Pose, camera: CameraModel) -> Array:
    """d corner (px) / d (rotation about the object's origin, shift), (8, 2, 6); NaN behind the camera."""
    turned = pose.apply(box.corners) - pose.translation
    moves = np.concatenate([turn_columns(turned) * _STEP_RAD, np.tile(np.eye(3) * _STEP_MM, (len(turned), 1, 1))], 2)
    xyz = (turned + pose.translation)[:, None, :]
    steps = moves.transpose(0, 2, 1)
    pixels, _ = camera.project(np.concatenate([xyz + steps, xyz - steps]).reshape(-1, 3))
    ahead, behind = pixels.reshape(2, len(turned), 6, 2)
    by_step = (ahead - behind) / 2
    return np.asarray((by_step / np.repeat([_STEP_RAD, _STEP_MM], 3)[:, None]).transpose(0, 2, 1))


def _sampled_tilts(found: BoxPose, normal: Array, covariance: Array) -> Spread | None:
    """All tilts of the marked side that fit, if the two mirrored minima run into each other, else None."""
    pose, observed = found.pose, found.observed
    middle = pose.apply(observed.points.mean(axis=0))[0]
    sight = middle / np.linalg.norm(middle)
    facing = -(pose.rotation @ normal)
    turn = np.cross(facing, sight)
    tilt = float(np.arctan2(np.linalg.norm(turn), facing @ sight))
    first = turn / np.linalg.norm(turn) if tilt > 1e-6 else np.cross(sight, _least_axis(sight))
    first /= np.linalg.norm(first)
    second = np.cross(sight, first)
    sigma = float(np.sqrt(first @ covariance[:3, :3] @ first))
    if tilt > APART * sigma:
        return None
    square = _turn((first * tilt)[None])[0]
    half = min(tilt + 4 * sigma, LARGEST_TILT)
    for _ in range(4):
        steps = np.linspace(-half, half, GRID)
        tilts = np.array([(a, b) for a in steps for b in steps])
        turns = _turn(tilts @ np.array([first, second])) @ square
        start = turns @ pose.rotation, turns @ (pose.translation - middle) + middle
        rotations, shifts, costs = _settled(observed, *start, sight)
        telling = costs < costs.min() + _TELLING * found.inflation
        reach = float(np.abs(tilts[telling]).max())
        if reach > 0.4 * half or half < 1e-4:
            break
        half = max(1.5 * reach, half / 6)
    weights = np.exp(-0.5 * (costs - costs.min()) / found.inflation)
    if found.rivals and found.alternative is None:  # where the poses just before decided, they count here too
        mirrored, odds = max(found.rivals, key=lambda rival: rival[1])
        weights *= np.where(_likeness(mirrored, rotations) > _likeness(pose, rotations), odds, 1.0)
    weights /= weights.sum()
    kept = np.nonzero(weights > _NEGLIGIBLE)[0]
    others = tuple((Pose(rotations[k], shifts[k]), float(weights[k])) for k in kept)
    return Spread(_without_tilt(found, first, second), others)


def _likeness(pose: Pose, rotations: Array) -> Array:
    """Grows as the angle between a pose and rotations (K, 3, 3) shrinks."""
    return np.asarray(np.einsum("ij,kij->k", pose.rotation, rotations))


def _without_tilt(found: BoxPose, first: Array, second: Array) -> Array:
    """The covariance that is left when the tilt is known."""
    free = np.zeros((6, 4))
    free[:3, 0] = np.cross(first, second)
    free[3:, 1:] = np.eye(3)
    return np.asarray(free @ covariance_of(free.T @ found.information @ free) @ free.T * found.inflation)


def _settled(observed: Observed, rotations: Array, shifts: Array, sight: Array) -> tuple[Array, Array, Array]:
    """Poses with spin and place fitted while their tilt is kept, and their costs (K,); two Gauss-Newton steps."""
    for _ in range(2):
        residuals, jacobian = _batch(observed, rotations, shifts, sight)
        normal = jacobian.transpose(0, 2, 1) @ jacobian
        normal += np.eye(4) * 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None]
        step = -np.linalg.solve(normal, jacobian.transpose(0, 2, 1) @ residuals[..., None])[..., 0]
        rotations = _turn(step[:, :1] * sight) @ rotations
        shifts = shifts + step[:, 1:]
    residuals, _ = _batch(observed, rotations, shifts, sight)
    costs = (residuals**2).sum(axis=1)
    return rotations, shifts, np.where(np.isfinite(costs), costs, np.inf)


def _batch(observed: Observed, rotations: Array, shifts: Array, sight: Array) -> tuple[Array, Array]:
    """Whitened residuals (K, 2N) and their slopes (K, 2N, 4) by spin about the sight line and by shift."""
    turned = np.einsum("kij,nj->kni", rotations, observed.points)
    xyz = turned + shifts[:, None, :]
    depth = np.maximum(xyz[..., 2:], NEAR_MM)
    off = xyz[..., :2] / depth - observed.rays
    count = 2 * len(observed.points)
    residuals = np.einsum("nab,knb->kna", observed.slopes, off).reshape(-1, count) @ observed.whitening.T
    ray = np.zeros((*depth.shape[:2], 2, 3))
    ray[..., 0, 0] = ray[..., 1, 1] = 1.0 / depth[..., 0]
    ray[..., :, 2] = -xyz[..., :2] / depth**2
    pixel = observed.slopes @ ray
    by_spin = pixel @ np.cross(sight, turned)[..., None]
    jacobian = np.concatenate([by_spin, pixel], axis=3).reshape(-1, count, 4)
    return residuals, observed.whitening @ jacobian


def _turn(vectors: Array) -> Array:
    """Rotation matrices (K, 3, 3) of rotation vectors (K, 3), by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = turn_columns(vectors).transpose(0, 2, 1)
    safe = np.maximum(angles, 1e-12)
    return np.asarray(np.eye(3) + np.sin(angles) / safe * cross + (1 - np.cos(angles)) / safe**2 * (cross @ cross))


def _least_axis(direction: Array) -> Array:
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(direction)))] = 1.0
    return axis
