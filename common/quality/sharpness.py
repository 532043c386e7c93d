"""Sharpness from the edges of the markers, which are known to go from black to white at one line. Pure.

100 = within one pixel, 50 = within two, 10 = within ten. It doesn't depend on the contrast, and a movement in one
direction is found by the edges across it: the worst of the four counts. (The slope of an edge's profile, as in the
slanted-edge method of ISO 12233, without its super-resolution.)
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import Quad

_PROFILES = 9
"""Along each edge, away from its ends."""
_REACH = 0.1
"""How far a profile goes to each side, as a share of the edge: beyond that are the marker's own cells."""
_LEAST_REACH_PX, _MOST_REACH_PX = 2.0, 16.0
_STEP_PX = 0.5
_LEAST_CONTRAST = 20.0


def sharpness_of(picture: NDArray[np.uint8], quads: Iterable[Quad]) -> float | None:
    """The sharpness (0..100) of the sharpest of some markers: a small or askew one says less. None for none.

    ``picture`` is BGR (H, W, 3) or grey (H, W); ``quads`` are markers' corners (px, integer = pixel centre).
    """
    found = [value for quad in quads if (value := edge_sharpness(picture, quad)) is not None]
    return max(found, default=None)


def edge_sharpness(picture: NDArray[np.uint8], quad: Quad) -> float | None:
    """The sharpness (0..100) of one marker's four edges, the worst of them; None if no edge can be judged."""
    corners = np.asarray(quad, dtype=np.float64)
    grey, corners = _cut_out(picture, corners)
    if grey is None:
        return None
    worst: list[float] = []
    for here, there in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        value = _edge(grey, here, there)
        if value is not None:
            worst.append(value)
    return min(worst, default=None)


def _cut_out(
    picture: NDArray[np.uint8], corners: NDArray[np.float64]
) -> tuple[NDArray[np.uint8] | None, NDArray[np.float64]]:
    """The part around the marker in grey, and the corners in it."""
    height, width = picture.shape[:2]
    low = np.maximum(np.floor(corners.min(axis=0) - _MOST_REACH_PX - 1), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0) + _MOST_REACH_PX + 2), (width, height)).astype(int)
    part = picture[low[1] : high[1], low[0] : high[0]]
    if part.size == 0:
        return None, corners
    grey = part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)
    return np.asarray(grey, dtype=np.uint8), corners - low


def _edge(grey: NDArray[np.uint8], here: NDArray[np.float64], there: NDArray[np.float64]) -> float | None:
    along = there - here
    length = float(np.hypot(*along))
    if length < 2 * _LEAST_REACH_PX:
        return None
    reach = min(max(_REACH * length, _LEAST_REACH_PX), _MOST_REACH_PX)
    across = np.array([-along[1], along[0]]) / length
    offsets = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
    places = here + np.linspace(0.15, 0.85, _PROFILES)[:, np.newaxis] * along
    points = places[:, np.newaxis, :] + offsets[np.newaxis, :, np.newaxis] * across
    inside = ((points >= 0) & (points <= np.array(grey.shape[::-1]) - 1)).all(axis=(1, 2))
    if not inside.any():
        return None
    maps = points[inside].astype(np.float32)
    profiles = cv2.remap(grey, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    contrast = profiles.max(axis=1) - profiles.min(axis=1)
    per_pixel = round(1 / _STEP_PX)
    steepest = np.abs(profiles[:, per_pixel:] - profiles[:, :-per_pixel]).max(axis=1)
    clear = contrast >= _LEAST_CONTRAST
    if not clear.any():
        return None
    return float(np.median(steepest[clear] / contrast[clear])) * 100.0
