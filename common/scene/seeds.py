"""Random generators that depend on names, not on the order in which things are made."""

from __future__ import annotations

import zlib

import numpy as np


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """The generator for one purpose: same seed and names, same numbers, on any machine and in any process."""
    words = [zlib.crc32(name.encode()) if isinstance(name, str) else name & 0xFFFFFFFF for name in names]
    return np.random.default_rng([seed & 0xFFFFFFFF, *words])
