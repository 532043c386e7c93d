"""How far two camera models of one picture size are apart, in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry.camera import CameraModel

_ALONG = 33


@dataclass(frozen=True)
class ModelDifference:
    """Distance (px) of where two models project the same ray, in the middle and at worst along the picture's edge."""

    centre_px: float
    edge_px: float


def model_difference(first: CameraModel, second: CameraModel) -> ModelDifference:
    """Compare two models by the rays of the first one's pixels; infinite where one of them has no ray.

    Raises ValueError for models of different picture sizes.
    """
    if (first.width, first.height) != (second.width, second.height):
        raise ValueError(f"{first.width}x{first.height} and {second.width}x{second.height} can't be compared")
    width, height = first.width - 1, first.height - 1
    along = np.linspace(0.0, 1.0, _ALONG)
    edge = [(along, 0 * along), (along, 0 * along + 1), (0 * along, along), (0 * along + 1, along)]
    pixels = np.concatenate([np.array([[0.5, 0.5]]), *(np.column_stack(side) for side in edge)]) * [width, height]
    rays = first.normalise(pixels)
    apart = np.full(len(pixels), np.inf)
    seen = np.isfinite(rays).all(axis=1)
    again, _ = second.project(np.column_stack([rays[seen], np.ones(int(seen.sum()))]) * 1000.0)
    apart[seen] = np.linalg.norm(again - pixels[seen], axis=1)
    return ModelDifference(float(apart[0]), float(apart[1:].max()))
