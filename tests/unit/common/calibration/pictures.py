"""Pictures of boards, rendered exactly: every pixel is the mean of rays cast on the board's pattern."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.boards import Board
from common.geometry import CameraModel

Array = NDArray[np.float64]
SUPER = 4
"""Rays along each side of a pixel."""
_PER_MM = 10
_COARSE = 8


def pattern(board: Board, margin_mm: float) -> NDArray[np.uint8]:
    """The board with a white margin, 10 px a mm, without any smoothing: edges exactly where they belong."""
    width, height = (round((side + 2 * margin_mm) * _PER_MM) for side in board.size_mm)
    crossings = np.zeros((height, width + 1), dtype=np.uint8)
    for loop in board.outlines():
        at = np.round((loop + margin_mm) * _PER_MM).astype(int)
        for (x, y), (other, end) in zip(at, np.roll(at, -1, axis=0), strict=True):
            if x == other:
                crossings[min(y, end) : max(y, end), x] ^= 1
    black = np.bitwise_xor.accumulate(crossings, axis=1)[:, :width]
    return np.where(black == 1, 25, 230).astype(np.uint8)


def picture(
    board: Board,
    camera: CameraModel,
    pose: Array,
    rng: np.random.Generator,
    *,
    noise: float = 2.0,
    blur_px: float = 0.6,
) -> NDArray[np.uint8]:
    """A grey picture (H, W) of the board before a grey wall."""
    margin = float(round(0.06 * max(board.size_mm)))
    drawn = pattern(board, margin)
    rays = _rays(camera)
    rotation = np.asarray(cv2.Rodrigues(pose[:3])[0])
    normal = rotation[:, 2]
    along = (normal @ pose[3:]) / (rays[..., 0] * normal[0] + rays[..., 1] * normal[1] + normal[2])
    at = np.dstack([rays[..., 0] * along, rays[..., 1] * along, along]) - pose[3:]
    x, y = ((at @ rotation[:, axis] + margin) * _PER_MM - 0.5 for axis in (0, 1))
    seen = cv2.remap(
        drawn,
        x.astype(np.float32),
        y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=120,
    )
    blurred = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), blur_px * SUPER)
    small = cv2.resize(blurred, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.clip(small + rng.normal(0, noise, small.shape), 0, 255).astype(np.uint8)


def _rays(camera: CameraModel) -> Array:
    """x/z, y/z (H * SUPER, W * SUPER, 2) of each ray; between every eighth by cubic interpolation."""
    size = (camera.width * SUPER, camera.height * SUPER)
    u, v = ((np.arange(0, side + _COARSE, _COARSE) + 0.5) / SUPER - 0.5 for side in size)
    known = camera.normalise(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)).reshape(len(v), len(u), 2)
    x, y = np.meshgrid(*(np.arange(side, dtype=np.float32) / _COARSE for side in size))
    found = [cv2.remap(known[..., axis].astype(np.float32), x, y, cv2.INTER_CUBIC) for axis in (0, 1)]
    return np.stack(found, axis=-1).astype(np.float64)
