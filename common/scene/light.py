"""Light: a lamp that wanders slowly, a gradient across the picture, the exposure that breathes with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.seeds import generator

Array = NDArray[np.float64]
_AMBIENT = 0.58
_PERIOD_FRAMES = 900.0


@dataclass(frozen=True, eq=False)
class Light:
    """``strength`` 0 is even light that never changes, 1 is a room with one lamp and a window."""

    seed: int
    strength: float = 1.0

    def shade(self, normal: Array, index: float) -> float:
        """How bright a plain surface with this outward unit normal (scene frame) is at a frame, 0..1."""
        diffuse = max(0.0, float(normal @ self.towards(index)))
        lit = _AMBIENT + (1.0 - _AMBIENT) * diffuse
        return float(1.0 - min(self.strength, 1.5) * (1.0 - lit) * 0.9)

    def exposure(self, index: float) -> float:
        """The gain of the whole picture at a frame, at most 1."""
        phase = self._phases[0] + 2 * np.pi * index / (_PERIOD_FRAMES * 0.61)
        return float(1.0 - self.strength * 0.045 * (1.0 + np.sin(phase)))

    def towards(self, index: float) -> Array:
        """The unit vector to the lamp, scene frame (x right, y down, z away from the first camera)."""
        around = 2 * np.pi * index / _PERIOD_FRAMES
        vector = np.array(
            [
                0.75 * np.sin(self._phases[1] + around),
                -0.75 + 0.15 * np.sin(self._phases[2] + 1.7 * around),
                -0.8 + 0.25 * np.cos(self._phases[1] + 0.8 * around),
            ]
        )
        return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)

    def field(self, width: int, height: int) -> NDArray[np.uint8]:
        """Light at each pixel (H, W, 3), 255 = all: a gradient in a seeded direction and darker corners."""
        angle = self._phases[3]
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
        across = (columns / max(width - 1, 1) - 0.5) * 2
        down = (rows / max(height - 1, 1) - 0.5) * 2
        slope = across * np.float32(np.cos(angle)) + down * np.float32(np.sin(angle)) * np.float32(0.6)
        loss = 0.09 * (1.0 + slope) / 2 + 0.10 * (across**2 + down**2) / 2
        grey = np.rint(255.0 * (1.0 - self.strength * loss)).clip(0, 255).astype(np.uint8)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)

    @cached_property
    def _phases(self) -> Array:
        return generator(self.seed, "light").uniform(0, 2 * np.pi, 4)
