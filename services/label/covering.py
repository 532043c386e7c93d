"""What stands before a marker and must not be erased with it: a hand that holds the object. Pure.

Depth tells: what is measured nearer than the marker's plane, by more than the sensor's noise, is something else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.label.masks import Crop, area_of, crop_around, mask_of
from services.label.occlusion import NEARER_MM, NEARER_SHARE, NEARER_SIGMA, DepthPicture
from services.label.robust import median
from services.label.surfaces import Region, Surface

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_PATCH = 5
_BAND = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
"""Depth and colour disagree by about three pixels on where the thing's edge is."""
_FAR = 65535
_SPARSE = 2
"""The noise is estimated from one pixel in so many, each way."""


@dataclass(frozen=True, eq=False)
class Covering:
    """``keep`` (H, W): pixels of regions that stay as they are; ``near`` (H, W): what no fill may look at."""

    keep: Mask
    near: Mask


def covering(regions: Sequence[Region], depth: DepthPicture) -> Covering | None:
    """What covers the regions of a picture; None if nothing does.

    Regions whose surface has a pose are judged; a marker that was detected never counts as mostly covered. Along
    the edge of what covers a marker a rim of 3 px of it is erased as well, so that no marker is left there, and a
    rim of 3 px around it feeds no fill. A hole in the depth picture covers nothing.
    """
    height, width = depth.values.shape
    groups = []
    for group in _by_surface(regions):
        crop = crop_around([region.polygon for region in group], width, height)
        if crop is not None:
            groups.append((group, crop, _nearer(group[0].surface, depth, crop)))
    if all(before is None for _, _, before in groups):
        return None
    found = Covering(np.zeros((height, width), dtype=bool), np.zeros((height, width), dtype=bool))
    bare = np.zeros((height, width), dtype=bool)
    for group, crop, before in groups:
        if before is None:
            for region in group:
                bare[crop.slices] |= mask_of([region.polygon], crop) > 0
            continue
        for region in group:
            inside = mask_of([region.polygon], crop) > 0
            # What was read isn't covered: the pose or the depth is off.
            read = region.polygon.because == "detected" and 2 * int(before[inside].sum()) > int(inside.sum())
            near = np.zeros_like(before) if read else before
            core = np.asarray(cv2.erode(near, _BAND, borderValue=1), dtype=np.uint8) > 0
            found.near[crop.slices] |= np.asarray(cv2.dilate(near, _BAND), dtype=np.uint8) > 0
            found.keep[crop.slices] |= inside & core
            bare[crop.slices] |= inside & ~core
    # Of two poses left open, or a pose and a detection, both must say so.
    np.logical_and(found.keep, ~bare, out=found.keep)
    return found if found.near.any() else None


def _by_surface(regions: Sequence[Region]) -> list[list[Region]]:
    """A marker that was detected and that a pose places is two regions of one surface: depth is asked once."""
    groups: dict[int, list[Region]] = {}
    for region in regions:
        groups.setdefault(id(region if region.surface is None else region.surface), []).append(region)
    return list(groups.values())


def _nearer(surface: Surface | None, depth: DepthPicture, crop: Crop) -> NDArray[np.uint8] | None:
    """Where (1, else 0) the crop's depth lies before the surface's plane; None if nowhere, or if that isn't known."""
    if surface is None or surface.depth_row is None:
        return None
    values = depth.values[crop.slices]
    middle = np.asarray(cv2.medianBlur(np.where(values == 0, np.uint16(_FAR), values), _PATCH), dtype=np.uint16)
    # Mostly nothing is there, which every second pixel shows: no patch's median is alone among its neighbours.
    _, near = _before(surface, surface.depth_row, middle[::2, ::2], depth.unit_mm, crop, 2)
    if not near.any():
        return None
    before, near = _before(surface, surface.depth_row, middle, depth.unit_mm, crop, 1)
    near &= before > NEARER_SIGMA * _noise_mm(values, middle, depth.unit_mm)
    if surface.outline is not None:
        # Beyond its side a plane goes on, and at a grazing angle it is soon behind the wall.
        near &= np.asarray(cv2.dilate(area_of(surface.outline, crop), _BAND)) > 0
    return near.astype(np.uint8) if near.any() else None


def _before(
    surface: Surface, depth_row: Array, middle: NDArray[np.uint16], unit_mm: float, crop: Crop, every: int
) -> tuple[Floats, Mask]:
    """By how much (mm) one in ``every`` rows and columns of a crop's depth lies before a plane; where by enough."""
    smooth = middle * np.float32(unit_mm)
    # On the plane z is linear in its coordinates, which a homography makes a quotient of two forms of the pixel.
    back = np.linalg.inv(surface.to_pixel)
    u = np.arange(crop.left, crop.right, every, dtype=np.float32)[None, :]
    v = np.arange(crop.top, crop.bottom, every, dtype=np.float32)[:, None]
    scale = back[2] @ [crop.left, crop.top, 1.0]
    above, below = (np.asarray(row / scale, dtype=np.float32) for row in (depth_row @ back, back[2]))
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = (above[0] * u + above[1] * v + above[2]) / (below[0] * u + below[1] * v + below[2])
        before = plane - smooth
        return before, np.asarray(before > np.maximum(NEARER_MM, NEARER_SHARE * plane))


def _noise_mm(values: NDArray[np.uint16], middle: NDArray[np.uint16], unit_mm: float) -> float:
    """One sigma of a depth picture's pixels, from how they scatter around the median of their neighbours."""
    apart = cv2.absdiff(values, middle)[::_SPARSE, ::_SPARSE]
    apart = apart[((values > 0) & (middle < _FAR))[::_SPARSE, ::_SPARSE]]
    return 1.4826 * median(apart) * unit_mm if apart.size else 0.0
