"""Where a bundle adjustment begins: poses from a guessed camera, and the focal length by trying several."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.calibration.adjust import Adjusted, adjust
from common.calibration.lens import EVEN, PLAIN, Lens
from common.calibration.views import View
from common.geometry import CameraModel

Array = NDArray[np.float64]
_FOCALS = (0.5, 0.8, 1.2, 1.8, 2.8, 4.5)
"""Focal lengths to try, in widths of the picture: one start alone can end in a wrong minimum."""
_VIEWS = 10


def pose_of(view: View, camera: CameraModel) -> Array:
    """The board's pose (6: Rodrigues vector, translation mm) in a view, for a camera that may be a guess."""
    rays = camera.normalise(view.corners)
    seen = np.isfinite(rays).all(axis=1)
    if seen.sum() < 4:
        rays, seen = CameraModel.guess(*view.size).normalise(view.corners), np.ones(len(rays), dtype=bool)
    points, rays = view.points[seen], rays[seen]
    # IPPE wants the plane's points around its origin; the shift is undone in the translation.
    middle = points.mean(axis=0)
    found, turns, shifts, _ = cv2.solvePnPGeneric(
        points - middle, rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    if not found:
        return np.array([0.0, 0, 0, *(-middle[:2]), 1000.0])
    turn, shift = np.asarray(turns[0]).ravel(), np.asarray(shifts[0]).ravel()
    return np.concatenate([turn, shift - np.asarray(cv2.Rodrigues(turn)[0]) @ middle])


def first_guess(views: Sequence[View], *, fisheye: bool = False) -> tuple[Lens, Array]:
    """A lens without distortion and its parameters: the best of several focal lengths, after a short fit."""
    lens = EVEN if fisheye else PLAIN
    some = views if len(views) <= _VIEWS else [views[i] for i in np.linspace(0, len(views) - 1, _VIEWS).astype(int)]
    width, height = some[0].size
    fits: list[Adjusted] = []
    for factor in _FOCALS:
        focal = factor * max(width, height)
        theta = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2])
        camera = lens.camera(theta, (width, height))
        poses = np.array([pose_of(view, camera) for view in some])
        fits.append(adjust(some, lens, theta, poses, flat=True, huber_px=3.0, iterations=12))
    sound = [fit for fit in fits if _sound(fit, width)] or fits
    best = min(sound, key=lambda fit: fit.rms)
    return lens, best.theta


def _sound(fit: Adjusted, width: int) -> bool:
    fx, fy, cx, _ = fit.theta
    return bool(0.2 * width < fx < 20 * width and 0.5 < fx / fy < 2 and -width < cx < 2 * width)
