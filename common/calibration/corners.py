"""Corners to a fraction of a pixel, and how sharp the edges between them are. Grey pictures, pixel centre = integer."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
WINDOW_SHARE = 0.2
"""Half the search window as a share of the distance to the nearest corner: a wider one reaches the next edges, which
pull at the corner (seen on OpenCV's own chessboards: 6 px off where half of the window is half of a square)."""
LEAST_WINDOW, MOST_WINDOW = 2, 8
USUAL_WINDOW = 11
"""Half the window of OpenCV's calibration samples."""
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
_PROFILE_STEP = 0.25


def spacing(corners: Array) -> float:
    """The least distance between two corners (N, 2), px; 0 for fewer than two."""
    if len(corners) < 2:
        return 0.0
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


def window_for(free_px: float) -> int:
    """Half the search window where the next corner is ``free_px`` away."""
    return int(np.clip(round(WINDOW_SHARE * free_px), LEAST_WINDOW, MOST_WINDOW))


def saddles(grey: Grey, corners: Array, window: int) -> Array:
    """Corners (N, 2) of a chessboard moved to where the edges around them meet (Foerstner and Guelch 1987)."""
    found = cv2.cornerSubPix(grey, corners.astype(np.float32).reshape(-1, 1, 2), (window, window), (-1, -1), _CRITERIA)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def crossings(grey: Grey, quads: Array) -> Array:
    """Corners (N, 4, 2) of dark squares, each where the lines through its two edges cross.

    Along the middle of each side the steepest point of the grey profile is found to a fraction of a pixel; a line
    through these points is no matter of a window, and not drawn inwards where an outer corner is rounded by blur.
    """
    picture = grey.astype(np.float32)
    out = quads.copy()
    for number, quad in enumerate(quads):
        lines = [_edge_line(picture, quad[side], quad[(side + 1) % 4]) for side in range(4)]
        for corner in range(4):
            first, second = lines[corner - 1], lines[corner]
            if first is None or second is None:
                continue
            found = np.cross(first, second)
            if abs(found[2]) > 1e-9 and np.linalg.norm(found[:2] / found[2] - quad[corner]) < 3.0:
                out[number, corner] = found[:2] / found[2]
    return out


def _edge_line(picture: NDArray[np.float32], start: Array, end: Array) -> Array | None:
    """The line (a, b, c) along an edge near start-end, or None where there is no clear one."""
    length = float(np.linalg.norm(end - start))
    reach = float(np.clip(0.12 * length, 1.5, 5.0))
    count = int(np.clip(length * 0.7, 5, 60))
    along = np.linspace(0.15, 0.85, count)[:, None]
    normal = np.array([start[1] - end[1], end[0] - start[0]]) / max(length, 1e-9)
    base = start + along * (end - start)
    offsets, profiles = _profiles(picture, base, normal, reach)
    slope = np.abs(np.diff(profiles, axis=1))
    strength = slope.sum(axis=1)
    clear = strength > 0.3 * max(float(strength.max()), 1e-6)
    if clear.sum() < 4:
        return None
    weight = slope[clear] ** 2
    middle = (offsets[1:] + offsets[:-1]) / 2
    at = (weight * middle).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    points = base[clear] + at[:, None] * normal
    for _ in range(2):
        line = _line(points)
        off = np.abs(points @ line[:2] + line[2])
        good = off <= max(2.5 * float(np.median(off)), 0.05)
        if good.all() or good.sum() < 4:
            break
        points = points[good]
    return _line(points)


def _line(points: Array) -> Array:
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][1]
    return np.array([normal[0], normal[1], -float(normal @ middle)])


def _profiles(picture: NDArray[np.float32], base: Array, normal: Array, reach: float) -> tuple[Array, Array]:
    """Offsets (M,) and grey values (N, M) across edges at ``base`` (N, 2), sampled bilinearly."""
    offsets = np.arange(-reach, reach + _PROFILE_STEP / 2, _PROFILE_STEP)
    at = (base[:, None] + offsets[None, :, None] * np.reshape(normal, (-1, 1, 2))).astype(np.float32)
    found = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return offsets, np.asarray(found, dtype=np.float64)


def edge_width(grey: Grey, corners: Array, reach_px: float) -> float:
    """How wide the edges between neighbouring corners (N, 2) are, px from 10 to 90 % of the step; 0 if unmeasurable.

    Half of the edges are blurred along by motion and stay sharp across; so it is the wider quarter that counts.
    ``reach_px``: how far to each side of an edge nothing else lies.
    """
    if len(corners) < 2:
        return 0.0
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    pairs = {tuple(sorted((int(index), int(other)))) for index in range(len(corners)) for other in _near(apart[index])}
    ends = np.array([(corners[first], corners[second]) for first, second in pairs])
    along = ends[:, 1] - ends[:, 0]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    reach = float(np.clip(reach_px, 2.0, 20.0))
    _, profiles = _profiles(grey.astype(np.float32), ends.mean(axis=1), normals, reach)
    contrast = profiles.max(axis=1) - profiles.min(axis=1)
    slope = np.abs(np.diff(profiles, axis=1)).max(axis=1) / _PROFILE_STEP
    clear = contrast > 0.3 * float(np.percentile(contrast, 90))
    if not clear.any():
        return 0.0
    # A Gaussian step: 10 to 90 % is 2.563 sigma, its steepest slope the contrast over 2.507 sigma.
    return float(np.percentile(1.022 * contrast[clear] / np.maximum(slope[clear], 1e-6), 75))


def _near(apart: Array) -> list[int]:
    """The two neighbours nearest to a corner in different directions are the ends of two of its edges."""
    order = np.argsort(apart)
    return [int(index) for index in order[:2] if np.isfinite(apart[index])]


def picture_edge_width(grey: Grey) -> float:
    """How wide the sharpest strong edges of a whole picture are, px; where no board was found, this tells blur."""
    contrast = cv2.dilate(grey, np.ones((15, 15))).astype(np.float32) - cv2.erode(grey, np.ones((15, 15)))
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    slope = cv2.dilate(np.hypot(across, down) / 8, np.ones((15, 15)))
    strong = contrast > max(40.0, 0.5 * float(contrast.max()))
    if not strong.any():
        return float("inf")
    return float(np.percentile(1.022 * contrast[strong] / np.maximum(slope[strong], 1e-3), 20))
