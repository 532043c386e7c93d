"""How a measured distance spreads around the real one, in the columns of the paper's Table 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Estimates (mm) of one real distance.

    ``mean_difference`` is signed (estimate minus real), ``range`` is max minus min, ``sd`` the sample standard
    deviation. ``frames`` is how many pictures there were, ``found`` how many gave an estimate.
    """

    real: float
    frames: int
    found: int
    min: float
    max: float
    mean: float
    sd: float
    mean_difference: float
    range: float

    def plain(self) -> dict[str, Any]:
        """For JSON: nothing found gives null."""
        return {key: None if value != value else value for key, value in vars(self).items()}


def spread(real: float, errors: Sequence[float], frames: int) -> Spread:
    """Of the errors (estimate minus real, mm) in ``frames`` pictures; all NaN where there are none."""
    if not errors:
        nan = float("nan")
        return Spread(real, frames, 0, nan, nan, nan, nan, nan, nan)
    values = np.asarray(errors, dtype=np.float64)
    low, high, mean = float(values.min()), float(values.max()), float(values.mean())
    sd = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return Spread(real, frames, len(values), real + low, real + high, real + mean, sd, mean, high - low)
