"""A fill that knows the plane it fills: what surrounds a marker on its side, carried on underneath it.

The side is rectified around the marker. There the fill is a smooth ground (a quadratic that lettering and other
features don't bend, plus a membrane that meets the surroundings) and the stripes that run along the side's axes and
enter on both sides. One-sided features, lettering say, end at the hole: nothing tells that they go on.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from services.label.rectify import rectified
from services.label.robust import median

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_CELL = 4
"""The ground is solved on cells of so many grid points squared."""
_STRIP = 10
"""Grid points beside the hole over which a stripe's level is averaged."""
_LEAST = 24
"""Grid points that must be seen."""
_TUKEY = 4.685
_LEAST_SCALE = 1.5
"""Grey values by which cells of one ground may differ at least."""
_SWEEPS = 4


def ground_and_stripes(
    bgr: Picture, sources: Mask, outline: Array, to_pixel: Array, part: tuple[int, int, int, int]
) -> Floats | None:
    """The fill without grain for a part (left, top, width, height) of a crop (H, W, 3), as (height, width, 3) float32.

    ``outline`` (N, 2) px is around what is to be filled, ``sources`` (H, W) may be looked at, ``to_pixel`` (3, 3)
    takes the plane to the crop's pixels. None if there is too little to look at.
    """
    grid = rectified(outline, to_pixel)
    values, seen = grid.look(bgr, sources)
    if cv2.countNonZero(seen) < _LEAST:
        return None
    weights = np.asarray(seen, dtype=np.float32) / np.float32(255)
    filled = _ground(values, weights)
    _add_stripes(filled, values, weights, grid.hole)
    return grid.back(filled, part)


def _ground(values: Floats, weights: Floats) -> Floats:
    """The smooth ground (h, w, 3) of a rectified neighbourhood; ``values`` are zero where the weight is."""
    height, width = weights.shape
    size = (max(width // _CELL, 2), max(height // _CELL, 2))
    share = np.asarray(cv2.resize(weights, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    mean: Floats = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    mean /= np.maximum(share, np.float32(1e-6))[..., None]
    known = share > 0.6
    if known.sum() < 12:
        known = share > 0.02
    places = np.flatnonzero(known)
    seen = np.ascontiguousarray(mean.reshape(-1, 3).take(places, axis=0).T)
    trend, trust = _robust_trend(seen, places, known.shape)
    # Beyond what was seen a quadratic goes anywhere.
    whole = trend + membrane(mean - trend, trust)
    np.clip(whole, seen.min(axis=1), seen.max(axis=1), out=whole)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _robust_trend(seen: Floats, places: NDArray[np.intp], shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """A quadratic (rows, columns, 3) through most of the cells, and by how much (rows, columns) each belongs to it.

    ``seen`` (3, N) are the known cells' colours, ``places`` (N,) which of the grid's (rows, columns) cells they are.
    Weighted by Tukey's biweight.
    """
    basis = _quadratics(*shape).reshape(6, -1)
    at, colours = basis.take(places, axis=1), seen.astype(np.float64)
    # Begins at the colour that most of the surroundings have, then lets the quadratic bend step by step.
    residual = colours - np.array([[median(channel)] for channel in colours])
    for terms in (1, 3, 6, 6):
        spread = (residual * residual).sum(axis=0)  # squared, as is its scale
        scale = max(median(spread), _LEAST_SCALE**2)
        trust = np.maximum(1.0 - spread / (_TUKEY**2 * scale), 0.0) ** 2
        weighted = at[:terms] * trust
        normal = weighted @ at[:terms].T + 1e-3 * np.eye(terms)
        solution = np.linalg.solve(normal, weighted @ colours.T)
        residual = colours - solution.T @ at[:terms]
    belongs = np.zeros(shape, dtype=np.float32)
    belongs.ravel()[places] = trust
    trend = basis.T @ solution
    return trend.reshape(*shape, 3).astype(np.float32), belongs


@lru_cache(maxsize=64)
def _quadratics(rows: int, columns: int) -> Array:
    """The six terms (6, rows, columns) of a quadratic over a grid from -1 to 1."""
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def membrane(values: Floats, weights: Floats) -> Floats:
    """Values (h, w, 3) kept where the weight is 1 and spread smoothly over where it is 0 (pull-push, relaxed)."""
    height, width = weights.shape
    fixed = values * weights[..., None]
    if min(height, width) <= 2:
        mean = fixed.sum(axis=(0, 1)) / max(float(weights.sum()), 1e-6)
        return np.asarray(np.broadcast_to(mean, values.shape), dtype=np.float32)
    half = ((width + 1) // 2, (height + 1) // 2)
    share = np.asarray(cv2.resize(weights, half, interpolation=cv2.INTER_AREA), dtype=np.float32)
    below: Floats = np.asarray(cv2.resize(fixed, half, interpolation=cv2.INTER_AREA), dtype=np.float32)
    below /= np.maximum(share, np.float32(1e-6))[..., None]
    solved = membrane(below, np.minimum(share * 2, np.float32(1.0)))
    free = np.asarray(cv2.merge([1 - weights] * 3), dtype=np.float32)
    out = np.asarray(cv2.resize(solved, (width, height), interpolation=cv2.INTER_LINEAR) * free + fixed, np.float32)
    for _ in range(_SWEEPS):
        cv2.blur(out, (3, 3), dst=out, borderType=cv2.BORDER_REPLICATE)
        out *= free
        out += fixed
    return out


def _add_stripes(filled: Floats, values: Floats, weights: Floats, hole: tuple[int, int, int, int]) -> None:
    """Lay over a ground what runs across the hole (left, top, right, bottom) along one of the axes."""
    left, top, right, bottom = hole
    rows, columns = slice(top, bottom), slice(left, right)
    level = _across(filled[rows], values[rows], weights[rows], left, right)
    turned = [item[:, columns].swapaxes(0, 1) for item in (filled, values, weights)]
    upright = _across(turned[0], turned[1], turned[2], top, bottom)
    if level is None and upright is None:
        return
    target = filled[rows, columns]
    if level is None or upright is None:
        target += level[0] if level is not None else upright[0].swapaxes(0, 1)  # type: ignore[index]
        return
    stronger = level[1][:, None] >= upright[1][None, :]
    target += np.where(stronger[..., None], level[0], upright[0].swapaxes(0, 1))


def _across(ground: Floats, values: Floats, weights: Floats, left: int, right: int) -> tuple[Floats, Floats] | None:
    """The stripes along x (h, right - left, 3) and the strength (h,) of each row's; None if there are none."""
    before, after = slice(max(left - _STRIP, 0), left), slice(right, right + _STRIP)
    first, first_seen = _profile(ground[:, before], values[:, before], weights[:, before])
    second, second_seen = _profile(ground[:, after], values[:, after], weights[:, after])
    both = first_seen & second_seen
    if not both.any():
        return None
    first_size, second_size = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    strength = np.minimum(first_size, second_size)
    noise = max(median(np.concatenate([first_size[first_seen], second_size[second_seen]])), 0.5)
    apart = np.linalg.norm(first - second, axis=1)
    agree = np.exp(-((apart / (0.35 * strength + noise)) ** 2)) * (strength > 3 * noise) * both
    if not agree.any():
        return None
    gate = cv2.blur(agree.astype(np.float32)[:, None], (1, 3))
    share = ((np.arange(left, right) - left + 0.5) / (right - left)).astype(np.float32)[None, :, None]
    stripes = (gate * first)[:, None] * (1 - share) + (gate * second)[:, None] * share
    return stripes.astype(np.float32), (gate.ravel() * strength).astype(np.float32)


def _profile(ground: Floats, values: Floats, weights: Floats) -> tuple[Floats, Mask]:
    """The mean (h, 3) by which each row of a strip differs from the ground, and where enough of it was seen."""
    total = weights.sum(axis=1)
    rest = np.einsum("ijk->ik", values) - np.einsum("ijk,ij->ik", ground, weights)
    mean = rest / np.maximum(total, 1e-6)[:, None]
    return mean.astype(np.float32), total >= _STRIP / 2
