"""Sub-pixel corners of a marker by aligning its known pattern with the picture.

Model of the grey value at pixel x:   I(x) = black(x) + contrast(x) * tone(P(G x))

G maps pixels to the marker's cells (a homography of undistorted pixels), P is the pattern (bits, black border, white
margin) blurred by a Gaussian of ``sigma`` pixels in closed form: each edge becomes an error function whose width
follows G's local scale. Black and contrast may vary linearly over the marker. ``tone`` bends the edges'
profile: blur happens in light but pixels are stored with a gamma (or overexposed), and without it every
white area seems larger than it is. All parameters are fitted by Gauss-Newton to the pixels near the pattern's
edges, robustly weighted (after B. D. Lucas, T. Kanade, IJCAI 1981 and S. Baker, I. Matthews, IJCV 2004; the
closed-form pattern in place of a warped template is ours). Where even light explains the picture badly, a shadow's
edge across the marker is tried too (`services.label.shade`). Pixels are read where they are; none is resampled.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel
from common.labels import Quad
from common.markers import Family
from common.messages import DetectedMarker
from services.label.edge_pattern import pattern_of
from services.label.lens import Lens
from services.label.pattern_fit import MIN_SHIFT_LIMIT_PX, PatternFit
from services.label.visible_objects import side_length

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

KIND = "photometric"
MIN_CONTRAST = 12.0
MAX_RESIDUAL, MAX_SMALL_RESIDUAL, SMALL_CELL_PX = 0.18, 0.25, 2.5
"""A hand leaves more, or a shadow's edge where even light was assumed; markers of small cells do by themselves."""
SHADOW_RESIDUAL, BETTER = 0.05, 0.7
"""A residual above the one may come from a faint shadow; one counts that leaves at most such a share of it."""
MAX_SHIFT = 0.08
"""Of the marker's side. Half a cell of the usual families is 0.06: further, and the pattern sits one cell off."""
MAX_FEW_SHIFT = 0.25
"""The same for two of the corners, if the other two stay: a finger over a corner leads a detector's lines astray."""


@dataclass(frozen=True, slots=True)
class Refined:
    """Corners TL TR BR BL (px) with their kind.

    ``shift_px`` is the furthest that a corner moved, ``residual`` the rms of picture minus model as a share of
    the contrast. Where not ``converged``, corners and kind are the coarse ones, and there is no ``covariance``:
    (8, 8) px^2 of the corners' x y x y ..., from the residual and the fit's information. ``doubt_px`` then says how
    far from each corner the attempt ended; None where the marker is too small or too cut off for one.
    """

    corners: Quad
    kind: str
    shift_px: float
    residual: float
    converged: bool
    covariance: Array | None = field(default=None, compare=False)
    doubt_px: tuple[float, ...] | None = None


def refine(
    picture: Picture,
    marker: DetectedMarker,
    family: Family,
    camera: CameraModel | None = None,
    margin: float | None = None,
) -> Refined:
    """Refine a marker's corners in a picture, (H, W) grey or (H, W, 3) BGR, uint8.

    ``camera`` gives the lens distortion, which bends a large marker's edges; None = straight edges. ``margin`` is the
    width of the white border as a share of the marker's side; None: wide. Corners are
    refused (the coarse ones come back) where the fit doesn't settle, explains the picture badly, or moves
    corners too far. Raises ValueError for an id that isn't in the family.
    """
    coarse = np.array(marker.corners, dtype=np.float64)
    pattern = pattern_of(family.bitmap(marker.id))
    lens = Lens(camera)
    fit = PatternFit.of(picture, pattern, coarse, lens, margin)
    if fit is None:
        return Refined(marker.corners, marker.kind, 0.0, float("inf"), converged=False)
    side = side_length(coarse)
    limit = MAX_RESIDUAL if side > SMALL_CELL_PX * pattern.cells else MAX_SMALL_RESIDUAL
    found, shifts = _attempt(fit, limit), _shifts(fit, lens, coarse)
    good = found and _near(shifts, side)
    if not good or fit.residual > SHADOW_RESIDUAL:
        shaded = copy.copy(fit)
        explained = shaded.add_shade(anew=not good) and _attempt(shaded, limit)
        if explained and (not good or shaded.residual < BETTER * fit.residual):
            moved = _shifts(shaded, lens, coarse)
            if _near(moved, side):
                fit, shifts, good = shaded, moved, True
    furthest = float(shifts.max())
    if not good:
        doubt = tuple(np.fmin(np.where(np.isfinite(shifts), shifts, side), side).tolist())
        return Refined(marker.corners, marker.kind, furthest, fit.residual, converged=False, doubt_px=doubt)
    corners = _quad(lens.distort(fit.corners))
    return Refined(corners, KIND, furthest, fit.residual, converged=True, covariance=fit.covariance())


def _attempt(fit: PatternFit, limit: float) -> bool:
    """Whether the fit settled, on a marker that can be seen, and explains the picture."""
    return fit.run() and fit.dimmest >= MIN_CONTRAST and fit.residual <= limit


def _shifts(fit: PatternFit, lens: Lens, coarse: Array) -> Array:
    """How far each corner moved (4,) px."""
    return np.asarray(np.linalg.norm(lens.distort(fit.corners) - coarse, axis=1))


def _quad(corners: Array) -> Quad:
    top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in corners)
    return top_left, top_right, bottom_right, bottom_left


def _near(shifts: Array, side: float) -> bool:
    """Whether corners moved (4,) px as far as a detector's may be off, and not by a cell of the pattern."""
    limit = max(MIN_SHIFT_LIMIT_PX, MAX_SHIFT * side)
    return bool(np.sort(shifts)[1] <= limit and shifts.max() <= max(limit, MAX_FEW_SHIFT * side))
