"""How like a filled region is to what was really there. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]

_GRAIN_SIGMA = 2.0
_STEADY = (0.01 * 255) ** 2, (0.03 * 255) ** 2


@dataclass(frozen=True)
class Likeness:
    """Of one region: mean squared error, SSIM, and the strength of its grain as a share of the truth's; pixels."""

    squared_error: float
    ssim: float
    grain: float
    pixels: int

    @property
    def psnr(self) -> float:
        """Peak signal to noise ratio, dB."""
        return psnr(self.squared_error)


def psnr(squared_error: float) -> float:
    """Peak signal to noise ratio in dB of a mean squared error of 8-bit values."""
    return float(10 * np.log10(255.0**2 / max(squared_error, 1e-6)))


def likenesses(filled: Picture, truth: Picture, regions: Iterable[Mask]) -> list[Likeness]:
    """Each region (H, W) of a filled picture (H, W, 3) against the truth."""
    similar = ssim(filled, truth)
    error = ((filled.astype(np.float32) - truth) ** 2).mean(axis=2)
    fine_filled, fine_truth = _fine(filled), _fine(truth)
    found = []
    for region in regions:
        # The rim is left out: at a seam anything is fine structure.
        inner = np.asarray(cv2.erode(region.view(np.uint8), np.ones((7, 7), np.uint8)), dtype=np.uint8) > 0
        inner = inner if inner.any() else region
        grain = float(fine_filled[inner].std() / max(float(fine_truth[inner].std()), 1e-6))
        found.append(Likeness(float(error[region].mean()), float(similar[region].mean()), grain, int(region.sum())))
    return found


def ssim(first: Picture, second: Picture) -> Floats:
    """Structural similarity (H, W), mean of the channels (Wang et al. 2004: Gaussian window of sigma 1.5, 11 wide)."""
    a, b = first.astype(np.float32), second.astype(np.float32)
    mean_a, mean_b = _window(a), _window(b)
    spread_a, spread_b = _window(a * a) - mean_a**2, _window(b * b) - mean_b**2
    common = _window(a * b) - mean_a * mean_b
    above = (2 * mean_a * mean_b + _STEADY[0]) * (2 * common + _STEADY[1])
    below = (mean_a**2 + mean_b**2 + _STEADY[0]) * (spread_a + spread_b + _STEADY[1])
    return np.asarray((above / below).mean(axis=2), dtype=np.float32)


def _window(values: Floats) -> Floats:
    return np.asarray(cv2.GaussianBlur(values, (11, 11), 1.5), dtype=np.float32)


def _fine(picture: Picture) -> Floats:
    values = picture.astype(np.float32)
    return np.asarray(values - cv2.GaussianBlur(values, (0, 0), _GRAIN_SIGMA), dtype=np.float32)
