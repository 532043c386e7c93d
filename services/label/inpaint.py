"""Erasing: fill the regions of markers from what surrounds them. Works in place on the caller's picture."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.labels import ErasedPolygon
from services.label.covering import Covering
from services.label.fill import fill
from services.label.masks import Crop, crops, mask_of
from services.label.regions import regions
from services.label.surfaces import Region

__all__ = ["METHODS", "Crop", "Region", "crops", "erase", "mask_of", "regions"]

Picture = NDArray[np.uint8]

_CV2 = {"telea": cv2.INPAINT_TELEA, "ns": cv2.INPAINT_NS}
METHODS = ("plane", "smooth", *_CV2)
"""``plane``: the side carried on underneath, with the picture's grain; ``smooth``: the same without grain;
``telea`` (Telea 2004) and ``ns`` (Bertalmio 2001): from what lies within ``radius_px``, whatever it belongs to."""


def erase(
    bgr: Picture,
    polygons: Sequence[ErasedPolygon | Region],
    method: str = "plane",
    radius_px: float = 3.0,
    covered: Covering | None = None,
) -> None:
    """Fill all polygons of a picture (H, W, 3) in place; pixels outside of them stay as they are.

    A ``Region`` says which side its polygon lies on, which ``plane`` and ``smooth`` make use of. What is
    ``covered`` is neither changed nor looked at. Raises ValueError for an unknown method.
    """
    if method not in METHODS:
        raise ValueError(f"there is no fill method {method!r}; known are {', '.join(METHODS)}")
    placed = [item if isinstance(item, Region) else Region(item) for item in polygons]
    if method in _CV2:
        _by_cv2(bgr, [item.polygon for item in placed], _CV2[method], radius_px, covered)
    elif placed:
        fill(bgr, placed, covered=covered, with_grain=method == "plane")


def _by_cv2(
    bgr: Picture, polygons: Sequence[ErasedPolygon], flag: int, radius_px: float, covered: Covering | None
) -> None:
    """On crops of merged regions, which gives the pixels of a fill of the whole picture for less."""
    height, width = bgr.shape[:2]
    for crop in crops(polygons, width, height, radius_px):
        mask = mask_of(polygons, crop)
        if mask.any():
            hole = mask > 0
            if covered is not None:
                # Filled as well, so that it feeds nothing, and not taken over.
                mask[covered.near[crop.slices]] = 255
                hole &= ~covered.keep[crop.slices]
            filled = cv2.inpaint(np.ascontiguousarray(bgr[crop.slices]), mask, radius_px, flag)
            np.copyto(bgr[crop.slices], filled, where=hole[..., None], casting="unsafe")
