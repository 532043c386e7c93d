"""Polygons as masks, and crops of the picture that hold them. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import ErasedPolygon

Mask = NDArray[np.uint8]

_FRACTION_BITS = 4
_AROUND = 0.25
"""How far around a region a fill looks, as a share of the region."""
_LEAST_AROUND_PX = 24


@dataclass(frozen=True, slots=True)
class Crop:
    """A rectangle of the picture, end exclusive."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Indexes a (H, W, ...) picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def overlaps(self, other: Crop) -> bool:
        """Whether the two share a pixel."""
        return (
            self.left < other.right and other.left < self.right and self.top < other.bottom and other.top < self.bottom
        )

    def union(self, other: Crop) -> Crop:
        """The smallest crop around both."""
        return Crop(
            min(self.left, other.left),
            min(self.top, other.top),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )


def mask_of(polygons: Sequence[ErasedPolygon], crop: Crop) -> Mask:
    """The erased pixels (255) of a crop: every pixel that a polygon touches."""
    mask: Mask = np.zeros((crop.bottom - crop.top, crop.right - crop.left), dtype=np.uint8)
    for polygon in polygons:
        mask |= area_of(np.array(polygon.polygon), crop)
    return mask


def area_of(outline: NDArray[np.float64], crop: Crop, line: int = cv2.LINE_8) -> Mask:
    """The pixels (255) of a crop that an outline (N, 2) px touches; with cv2.LINE_AA by how much."""
    mask: Mask = np.zeros((crop.bottom - crop.top, crop.right - crop.left), dtype=np.uint8)
    shifted = np.round((outline - (crop.left, crop.top)) * (1 << _FRACTION_BITS)).astype(np.int32)
    cv2.fillPoly(mask, [shifted], 255, line, _FRACTION_BITS)
    return mask


def crop_around(polygons: Sequence[ErasedPolygon], width: int, height: int) -> Crop | None:
    """The crop with polygons and their neighbourhood; None if it lies outside the picture."""
    points = np.concatenate([np.array(polygon.polygon) for polygon in polygons])
    low, high = np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))
    pad = max(_AROUND * float((high - low).max()), _LEAST_AROUND_PX)
    crop = Crop(
        max(int(low[0] - pad), 0),
        max(int(low[1] - pad), 0),
        min(int(high[0] + pad) + 1, width),
        min(int(high[1] + pad) + 1, height),
    )
    return crop if crop.left < crop.right and crop.top < crop.bottom else None


def crops(polygons: Sequence[ErasedPolygon], width: int, height: int, radius_px: float) -> list[Crop]:
    """Disjoint crops that hold all polygons and, around each, all that its fill may look at."""
    # Twice the radius: the fill looks that far around a pixel, at pixels whose own gradients it takes.
    pad = 2 * int(np.ceil(radius_px)) + 4
    found: list[Crop] = []
    for polygon in polygons:
        corners = np.array(polygon.polygon)
        low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
        crop = Crop(
            max(int(low[0]) - pad, 0),
            max(int(low[1]) - pad, 0),
            min(int(high[0]) + pad + 1, width),
            min(int(high[1]) + pad + 1, height),
        )
        if crop.left < crop.right and crop.top < crop.bottom:
            found = _merged(found, crop)
    return found


def _merged(found: list[Crop], crop: Crop) -> list[Crop]:
    """Add a crop; whatever it touches becomes one with it, and that may touch further ones."""
    while touching := [other for other in found if crop.overlaps(other)]:
        found = [other for other in found if other not in touching]
        for other in touching:
            crop = crop.union(other)
    return [*found, crop]
