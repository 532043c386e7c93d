"""A marker's neighbourhood seen squarely: a grid on its plane that is about as fine as the picture is there. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_AROUND = 0.2
"""How far the neighbourhood reaches beyond the hole, as a share of the hole, on each side."""
_LEAST_AROUND = 14.0
_MOST_CELLS = 224
_WHOLE = 4
"""Grid points come in such numbers, so that the ground's cells are whole ones."""


@dataclass(frozen=True, eq=False)
class Grid:
    """``to_pixel`` (3, 3) takes grid points (column, row) to the crop's pixels; ``size`` is (columns, rows).

    ``hole`` is what is to be filled: left, top, right, bottom in grid points, the latter two exclusive.
    """

    to_pixel: Array
    size: tuple[int, int]
    hole: tuple[int, int, int, int]

    def look(self, bgr: Picture, sources: Mask) -> tuple[Floats, Picture]:
        """The picture seen through the grid: colours (h, w, 3) float32, zero where no source is, and 255 where one."""
        both = cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA)
        cv2.insertChannel(sources.view(np.uint8) * np.uint8(255), both, 3)
        both = cv2.warpPerspective(both, self.to_pixel, self.size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        _, seen = cv2.threshold(cv2.extractChannel(both, 3), 250, 255, cv2.THRESH_BINARY)
        values = cv2.cvtColor(both, cv2.COLOR_BGRA2BGR)
        values = cv2.bitwise_and(values, values, mask=seen)
        return values.astype(np.float32), np.asarray(seen, dtype=np.uint8)

    def back(self, values: Floats, part: tuple[int, int, int, int]) -> Floats:
        """Values (h, w, 3) on the grid as a part (left, top, width, height) of the crop sees them."""
        left, top, width, height = part
        shift = np.array([[1.0, 0, -left], [0, 1.0, -top], [0, 0, 1.0]])
        back = cv2.warpPerspective(
            values,
            shift @ self.to_pixel,
            (width, height),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(back, dtype=np.float32)


def rectified(outline: Array, to_pixel: Array) -> Grid:
    """The grid around an outline (N, 2) px on the plane of ``to_pixel``; in the picture itself where that fails."""
    found = _on_plane(outline, to_pixel)
    return found or _grid(outline.min(axis=0), outline.max(axis=0), np.array([1.0, 1.0]), np.eye(3))


def _on_plane(outline: Array, to_pixel: Array) -> Grid | None:
    back = np.linalg.inv(to_pixel)
    back = back if float(back[2] @ [*outline.mean(axis=0), 1.0]) > 0 else -back
    homogeneous = np.column_stack([outline, np.ones(len(outline))]) @ back.T
    if not (homogeneous[:, 2] > 1e-9 * np.abs(back).max()).all():
        return None
    plane = homogeneous[:, :2] / homogeneous[:, 2:]
    low, high = plane.min(axis=0), plane.max(axis=0)
    forward = to_pixel / (to_pixel[2] @ [*((low + high) / 2), 1.0])
    centre = forward[:2] @ [*((low + high) / 2), 1.0]
    slopes = forward[:2, :2] - np.outer(centre, forward[2, :2])
    scale = np.linalg.norm(slopes, axis=0)
    if not np.isfinite(scale).all() or scale.min() <= 0 or (high - low).min() <= 0:
        return None
    grid = _grid(low, high, scale, to_pixel)
    # All of the grid must lie before the horizon, else the warp would fold.
    corners = np.column_stack([_corners(0, 0, *grid.size), np.ones(4)]) @ grid.to_pixel[2]
    same = (corners > 0).all() or (corners < 0).all()
    spread = np.abs(corners).max() / max(np.abs(corners).min(), 1e-12)
    return grid if same and spread < 8 else None


def _grid(low: Array, high: Array, scale: Array, to_pixel: Array) -> Grid:
    """``scale``: pixels to a unit of the plane along each axis."""
    extent = (high - low) * scale
    around = np.maximum(_AROUND * extent, _LEAST_AROUND)
    cells = np.clip(np.ceil((extent + 2 * around) / _WHOLE) * _WHOLE, 2 * _WHOLE, _MOST_CELLS).astype(int)
    step = (extent + 2 * around) / scale / cells
    start = low - around / scale + step / 2
    to_plane = np.array([[step[0], 0, start[0]], [0, step[1], start[1]], [0, 0, 1.0]])
    first = np.floor(around / scale / step).astype(int)
    last = np.ceil((extent + around) / scale / step).astype(int)
    hole = (int(first[0]), int(first[1]), int(last[0]), int(last[1]))
    return Grid(to_pixel @ to_plane, (int(cells[0]), int(cells[1])), hole)


def _corners(left: float, top: float, right: float, bottom: float) -> Array:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=np.float64)
