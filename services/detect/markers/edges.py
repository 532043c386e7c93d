"""Fit the sides of many quads to the picture's edges at once.

Across each side, profiles are read; the centre of gravity of the (squared) rise from dark inside to bright
outside is the edge there, and a weighted straight line through these is the side. Two neighbours meet in a
corner. (Weighted edge fitting after E. Olson, J. Wang, IROS 2016; all quads in one pass of array operations.)
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from services.detect.markers.base import Grey

Array = NDArray[np.float64]

ALONG = np.linspace(0.1, 0.9, 14)
"""Where along a side profiles are read; not at the corners, where blur rounds the edge."""
ACROSS = np.linspace(-1.0, 1.0, 9)
LARGEST_STEP = 0.35
"""A corner that moves further than this share of the quad's size keeps its place."""
LARGEST_STEP_PX = 3.0


def fit_edges(grey: Grey, quads: Array, reach: Array) -> Array:
    """Quads (K, 4, 2) px, clockwise, moved onto edges that lie within ``reach`` (K,) px of their sides."""
    start, end = quads, np.roll(quads, -1, axis=1)
    along = end - start
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-6)
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1) / length[..., None]
    offsets = reach[:, None] * ACROSS
    levels = _profiles(grey, start, along, outward, offsets)
    rise = np.maximum(np.diff(levels, axis=-1), 0.0)
    weight = rise * rise
    total = weight.sum(axis=-1) + 1e-3
    between = (offsets[:, 1:] + offsets[:, :-1]) / 2
    position = np.einsum("ksar,kr->ksa", weight, between) / total
    at_start, at_end = _lines(position, np.sqrt(total))
    first = start + at_start[..., None] * outward
    last = end + at_end[..., None] * outward
    corners = _meet(np.roll(first, 1, axis=1), np.roll(last, 1, axis=1), first, last)
    moved = np.hypot(*np.moveaxis(corners - quads, -1, 0))
    limit = np.maximum(LARGEST_STEP * length.mean(axis=1), LARGEST_STEP_PX)
    return np.where((moved <= limit[:, None])[..., None], corners, quads)


def read(grey: Grey, x: Array, y: Array) -> NDArray[np.float32]:
    """Levels of a picture at places (K, N), bilinear; beyond its border that of the nearest pixel."""
    levels = cv2.remap(
        grey, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(levels, dtype=np.float32)


def _profiles(grey: Grey, start: Array, along: Array, outward: Array, offsets: Array) -> NDArray[np.float32]:
    """Levels (K, 4, len(ALONG), len(ACROSS)) across the sides, from inside to outside."""
    count = len(start)
    places = [
        (start[..., None, None, axis] + along[..., None, None, axis] * ALONG[:, None])
        + outward[..., None, None, axis] * offsets[:, None, None, :]
        for axis in (0, 1)
    ]
    flat = [place.reshape(count * 4, -1) for place in places]
    return read(grey, *flat).reshape(count, 4, len(ALONG), len(ACROSS))


def _lines(position: Array, weight: Array) -> tuple[Array, Array]:
    """Weighted straight lines through offsets (K, 4, len(ALONG)): their offsets (K, 4) at a side's start and end."""
    s = ALONG - 0.5
    w = weight.sum(axis=-1)
    ws, wss = weight @ s, weight @ (s * s)
    wp = (weight * position).sum(axis=-1)
    wsp = (weight * position) @ s
    slope = (w * wsp - ws * wp) / np.maximum(w * wss - ws * ws, 1e-9)
    middle = (wp - slope * ws) / w
    return middle - slope / 2, middle + slope / 2


def _meet(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Where the lines through a, b and through c, d meet; all (K, 4, 2). Far away where they are parallel."""
    ab, cd, ac = b - a, d - c, c - a
    cross = ab[..., 0] * cd[..., 1] - ab[..., 1] * cd[..., 0]
    cross = np.where(np.abs(cross) < 1e-6, 1e-6, cross)
    t = (ac[..., 0] * cd[..., 1] - ac[..., 1] * cd[..., 0]) / cross
    return np.asarray(a + t[..., None] * ab)
