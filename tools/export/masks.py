"""Which pixels of the exported picture show which target: nearer objects cover farther ones."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.objects import back_to_front
from tools.export.model import Shot, Target

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def polygon_mask(outline: Array, size: tuple[int, int]) -> Mask:
    """The pixels (H, W) whose centres a convex polygon (N, 2) covers; ``size``: width, height.

    Row by row between the polygon's leftmost and rightmost crossing; cv2.fillPoly adds the pixels that the edges touch.
    """
    width, height = size
    if len(outline) < 3:
        return np.zeros((height, width), dtype=bool)
    here, there = outline[None], np.roll(outline, -1, axis=0)[None]
    rows = np.arange(height, dtype=np.float64)[:, None]
    crossed = (here[..., 1] <= rows) != (there[..., 1] <= rows)
    rise = np.where(crossed, there[..., 1] - here[..., 1], 1.0)
    x = here[..., 0] + (rows - here[..., 1]) * (there[..., 0] - here[..., 0]) / rise
    left = np.where(crossed, x, np.inf).min(axis=1)[:, None]
    right = np.where(crossed, x, -np.inf).max(axis=1)[:, None]
    columns = np.arange(width)[None]
    return np.asarray((columns >= left) & (columns < right))


def covering(shot: Shot) -> list[list[Target]]:
    """For each target the targets of other objects that lie before it and overlap its window."""
    if len({target.item.name for target in shot.targets}) < 2:
        return [[] for _ in shot.targets]
    order = back_to_front(list(shot.source.boxes.values()), shot.source.poses)
    rank = {name: number for number, name in enumerate(order)}
    return [
        [other for other in shot.targets if rank[other.item.name] > rank[target.item.name] and _overlap(target, other)]
        for target in shot.targets
    ]


def visible_mask(shot: Shot, target: Target, before: list[Target]) -> Mask:
    """The pixels of a target that no nearer object covers."""
    size = (shot.camera.width, shot.camera.height)
    mask = polygon_mask(target.outline, size)
    for other in before:
        mask &= ~polygon_mask(other.outline, size)
    return mask


def visible_outlines(shot: Shot) -> list[Array]:
    """Each target's visible outline (N, 2), exact where nothing is before it; (0, 2) where nothing is visible."""
    found = []
    for target, before in zip(shot.targets, covering(shot), strict=True):
        found.append(target.outline if not before else _largest_piece(visible_mask(shot, target, before)))
    return found


def _largest_piece(mask: Mask) -> Array:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.zeros((0, 2))
    largest = max(contours, key=cv2.contourArea)
    return np.asarray(cv2.approxPolyDP(largest, 0.7, True), dtype=np.float64).reshape(-1, 2)


def _overlap(one: Target, other: Target) -> bool:
    a, b = one.window, other.window
    return a.x_min < b.x_max and b.x_min < a.x_max and a.y_min < b.y_max and b.y_min < a.y_max


def runs(mask: Mask) -> list[int]:
    """COCO's run lengths of a mask (H, W), column by column, the first of zeros."""
    flat = mask.ravel(order="F")
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flat, [False]]).astype(np.int8)))
    runs = np.diff(np.concatenate([[0], edges, [len(flat)]]))
    return [int(value) for value in (runs[:-1] if runs[-1] == 0 else runs)]
