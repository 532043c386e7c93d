"""A shadow's edge across a marker: one straight, soft step of the light.

    light(x) = 1 - depth * S((n . x - offset) / width),   S the logistic function, n = (cos angle, sin angle)

in the coordinates of the fit that uses it (undistorted pixels, centred on the marker and scaled by its reach). The
shadow belongs to the room, not to the marker: it stays where it is while the marker's corners move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS = 4
ANGLES = 16
OFFSETS = np.linspace(-0.75, 0.75, 11)
FIRST_WIDTH_PX = 1.0
MIN_WIDTH_PX, MAX_WIDTH_PX = 0.15, 6.0
"""Of the logistic step; a sun's shadow a metre away is as soft as the upper one in most pictures."""
MIN_DEPTH, MAX_DEPTH = 0.1, 0.95
MIN_SHARE = 0.1
"""Of the pixels, on each side of the edge."""
EXPLAINED = 0.5
"""The part of the squared error under even light that two lights must take away."""
_STEEP = 30.0


@dataclass(frozen=True, slots=True)
class Shade:
    """The step: ``angle`` (rad) of its normal, which points into the shade, ``offset``, ``width``, ``depth`` 0 to 1.

    ``unit_px``: pixels to a unit of the coordinates.
    """

    angle: float
    offset: float
    width: float
    depth: float
    unit_px: float

    @classmethod
    def guess(cls, where: Array, grey: Array, pattern: Array, unit_px: float) -> Shade | None:
        """The edge that best parts pixels ``where`` (N, 2) of grey values (N,) into two lights on one pattern.

        ``pattern`` (N,): 0 black to 1 white, as expected under even light. None where no edge explains much.
        """
        terms = np.column_stack([np.ones_like(grey), pattern, pattern**2, grey, grey**2, pattern * grey])
        total = terms.sum(axis=0)
        best, chosen = EXPLAINED * float(_line(total)[1]), None
        for angle in np.arange(ANGLES) * 2 * np.pi / ANGLES:
            bins = np.searchsorted(OFFSETS, where @ np.array([np.cos(angle), np.sin(angle)]))
            sums = [np.bincount(bins, column, len(OFFSETS) + 1) for column in terms.T]
            lit: Array = np.cumsum(np.column_stack(sums), axis=0, dtype=np.float64)[:-1]  # short of each offset
            dark = total - lit
            (lit_contrast, lit_error), (dark_contrast, dark_error) = _line(lit), _line(dark)
            share = dark[:, 0] / total[0]
            fits = (share > MIN_SHARE) & (share < 1 - MIN_SHARE) & (dark_contrast > 0) & (dark_contrast < lit_contrast)
            errors = np.where(fits, lit_error + dark_error, np.inf)
            least = int(errors.argmin())
            if errors[least] < best:
                best, depth = float(errors[least]), 1 - float(dark_contrast[least] / lit_contrast[least])
                chosen = cls(float(angle), float(OFFSETS[least]), FIRST_WIDTH_PX / unit_px, depth, unit_px)
        return None if chosen is None or chosen.depth < MIN_DEPTH else chosen

    def on(self, where: Array) -> tuple[Array, Array]:
        """Light (N,) at points (N, 2), and its slopes (N, 4) by angle, offset, log width and depth."""
        normal, across = (
            np.array([np.cos(self.angle), np.sin(self.angle)]),
            np.array([-np.sin(self.angle), np.cos(self.angle)]),
        )
        s = np.clip((where @ normal - self.offset) / self.width, -_STEEP, _STEEP)
        step = 1.0 / (1.0 + np.exp(-s))
        slope = -self.depth * step * (1.0 - step)
        return 1.0 - self.depth * step, np.column_stack(
            [slope * (where @ across) / self.width, -slope / self.width, -slope * s, -step]
        )

    def moved(self, step: Array) -> Shade:
        """After a step (4,) of the fit, within what a shadow can be."""
        width = self.width * float(np.exp(np.clip(step[2], -0.5, 0.5)))
        return Shade(
            self.angle + float(np.clip(step[0], -0.3, 0.3)),
            self.offset + float(np.clip(step[1], -0.2, 0.2)),
            float(np.clip(width, MIN_WIDTH_PX / self.unit_px, MAX_WIDTH_PX / self.unit_px)),
            float(np.clip(self.depth + step[3], 0.0, MAX_DEPTH)),
            self.unit_px,
        )


def _line(sums: Array) -> tuple[Array, Array]:
    """The line of grey over pattern values: its slope (white minus black) and the squared distances from it, summed.

    ``sums`` (..., 6): of 1, p, p^2, g, g^2, p g.
    """
    count, p, pp, g, gg, pg = np.moveaxis(sums, -1, 0)
    count = np.maximum(count, 1.0)
    spread = np.maximum(pp - p**2 / count, 1e-9)
    joint = pg - p * g / count
    return joint / spread, np.maximum(gg - g**2 / count - joint**2 / spread, 0.0)
