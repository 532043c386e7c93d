"""Fills regions surface by surface, each only from pixels of its own surface. Works in place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import ErasedPolygon
from services.label.covering import Covering
from services.label.fill_plane import ground_and_stripes, membrane
from services.label.grain import grain
from services.label.masks import Crop, area_of, crop_around, mask_of
from services.label.surfaces import Region, Surface

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_EDGE = np.ones((5, 5), np.uint8)
"""Pixels so near to a side's edge may hold a part of what lies beyond it."""
_ENOUGH = 200
"""Pixels that a fill can learn from."""
_BLUR_PX = 0.7


@dataclass(frozen=True, eq=False)
class _Work:
    """The regions of one marker's neighbourhood that share a surface."""

    polygons: tuple[ErasedPolygon, ...]
    surface: Surface | None


@dataclass(frozen=True, eq=False)
class _Task:
    """A crop (H, W, 3), its hole (H, W), what may be looked at (H, W), the hole's outline (N, 2); seed of its grain."""

    bgr: Picture
    hole: Mask
    sources: Mask
    outline: Array
    seed: int | None


def fill(bgr: Picture, regions: Sequence[Region], *, covered: Covering | None = None, with_grain: bool = True) -> None:
    """Fill all regions of a picture (H, W, 3) in place.

    ``covered``: what stands before markers; it stays as it is and is not looked at.
    """
    height, width = bgr.shape[:2]
    polygons = [region.polygon for region in regions]
    works = [
        (work, crop) for work in _grouped(regions) if (crop := crop_around(work.polygons, width, height)) is not None
    ]
    # Cut out before the first is filled: no fill may feed another.
    parts = [bgr[crop.slices].copy() for _, crop in works]
    done = np.zeros((height, width), dtype=bool)
    for number, ((work, crop), part) in enumerate(zip(works, parts, strict=True)):
        forbidden = mask_of(polygons, crop) > 0
        hole = (mask_of(work.polygons, crop) > 0) & ~done[crop.slices]
        if covered is not None:
            forbidden |= covered.near[crop.slices]
            hole &= ~covered.keep[crop.slices]
        if not hole.any():
            continue
        task = _Task(part, hole, ~forbidden, _outline(work.polygons, crop), number if with_grain else None)
        filled = _filled(task, crop, work.surface)
        cv2.copyTo(filled, hole.view(np.uint8), bgr[crop.slices])
        done[crop.slices] |= hole


def _grouped(regions: Sequence[Region]) -> list[_Work]:
    """Regions of one marker in one place together, near surfaces first."""
    works: list[_Work] = []
    for region in regions:
        for index, work in enumerate(works):
            if work.polygons[0].marker == region.polygon.marker and work.surface is region.surface:
                works[index] = _Work((*work.polygons, region.polygon), work.surface)
                break
        else:
            works.append(_Work((region.polygon,), region.surface))
    return sorted(works, key=lambda work: float("inf") if work.surface is None else work.surface.distance_mm)


def _filled(task: _Task, crop: Crop, surface: Surface | None) -> Picture:
    """The crop with its hole filled: each layer that the hole reaches into from that layer alone."""
    shift = np.array([[1.0, 0, -crop.left], [0, 1.0, -crop.top], [0, 0, 1.0]])
    to_pixel = shift if surface is None else shift @ surface.to_pixel
    if surface is None or surface.outline is None:
        return _one(task, task.sources, to_pixel)
    before, left = _peeled(surface.nearer, np.ones(task.hole.shape, dtype=np.float32), crop)
    (own,), left = _peeled([surface.outline], left, crop)
    if float(own.min()) > 0.99:
        return _one(task, task.sources, to_pixel)
    if float(own[task.hole].min()) > 0.98:
        return _one(task, _inside(task, own), to_pixel)
    beside, left = _peeled(surface.beside, left, crop)
    layers = [own, *before, *beside, left]
    last = len(layers) - 1
    total = np.zeros(task.bgr.shape, dtype=np.float32)
    for number, share in enumerate(layers):
        if float(share[task.hole].max()) > 0.02:
            here = _inside(task, share)
            if number == last:
                # A room is no plane, and only a rim of it is missing: what is nearest counts.
                filled = membrane(task.bgr.astype(np.float32), here.astype(np.float32))
            else:
                filled = _one(task, here, shift if number else to_pixel).astype(np.float32)
            total += share[..., None] * filled
    return np.asarray(np.clip(np.rint(total), 0, 255), dtype=np.uint8)


def _inside(task: _Task, share: Floats) -> Mask:
    """What may be looked at of a layer; of a large one not its edges, which hold a part of what lies beyond."""
    area = task.sources & (share > 0.5)
    inner = area & _apart(share > 0.5)
    return inner if cv2.countNonZero(inner.view(np.uint8)) > _ENOUGH else area


def _peeled(outlines: Sequence[Array], left: Floats, crop: Crop) -> tuple[list[Floats], Floats]:
    """By how much (0..1) each pixel of a crop shows each of the outlines, the first one foremost; and what is behind.

    ``left``: by how much it shows any of this.
    """
    layers = []
    for outline in outlines:
        layers.append(left * _coverage(outline, crop))
        left = left - layers[-1]
    return layers, left


def _apart(area: Mask) -> Mask:
    """An area without what lies too near to its edge."""
    return np.asarray(cv2.erode(area.view(np.uint8), _EDGE), dtype=np.uint8) > 0


def _one(task: _Task, sources: Mask, to_pixel: Array) -> Picture:
    """The crop with its hole filled from ``sources``; by Telea where there is too little of them."""
    left, top, width, height = cv2.boundingRect(task.hole.view(np.uint8))
    smooth = ground_and_stripes(task.bgr, sources, task.outline, to_pixel, (left, top, width, height))
    if smooth is None:
        return np.asarray(cv2.inpaint(task.bgr, task.hole.view(np.uint8), 3.0, cv2.INPAINT_TELEA), dtype=np.uint8)
    texture = None if task.seed is None else grain(task.bgr, sources, (width, height), task.seed)
    if texture is None:
        texture = np.zeros_like(smooth)
    out = task.bgr.copy()
    cv2.add(smooth, texture, dst=out[top : top + height, left : left + width], dtype=cv2.CV_8U)
    return out


def _outline(polygons: Sequence[ErasedPolygon], crop: Crop) -> Array:
    """The points (N, 2) of polygons, in pixels of the crop."""
    return np.concatenate([np.array(polygon.polygon) for polygon in polygons]) - (crop.left, crop.top)


def _coverage(outline: Array, crop: Crop) -> Floats:
    """How much of each pixel (0..1) of a crop lies inside an outline, as a lens sees it."""
    share = area_of(outline, crop, cv2.LINE_AA).astype(np.float32) / np.float32(255)
    return np.asarray(cv2.GaussianBlur(share, (0, 0), _BLUR_PX), dtype=np.float32)
