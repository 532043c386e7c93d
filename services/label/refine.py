"""Sub-pixel corners of a marker by aligning its known pattern with the picture.

Model of the grey value at pixel x:   I(x) = black(x) + contrast(x) * tone(P(G x))

G maps pixels to the marker's cells (a homography of undistorted pixels), P is the pattern (bits, black border, white
margin) blurred by a Gaussian of ``sigma`` pixels in closed form: each edge becomes an error function whose width
follows G's local scale. Black and contrast may vary linearly over the marker. ``tone`` bends the edges'
profile: blur happens in light but pixels are stored with a gamma (or overexposed), and without it every
white area seems larger than it is. All parameters are fitted by Gauss-Newton to the pixels near the pattern's
edges, robustly weighted (after B. D. Lucas, T. Kanade, IJCAI 1981 and S. Baker, I. Matthews, IJCV 2004; the
closed-form pattern in place of a warped template is ours). Pixels are read where they are; none is resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import CameraModel
from common.labels import Quad
from common.markers import Family
from common.messages import DetectedMarker
from services.label.edge_pattern import Pattern, pattern_of
from services.label.lens import Lens
from services.label.visible_objects import side_length

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

KIND = "photometric"
MAX_ITERATIONS = 14
FIRST_SIGMA_PX = 1.4
"""Wide at first, so that corners that are off by two pixels still feel their edge."""
FIRST_SIGMA_CELLS, LEAST_FIRST_SIGMA_PX = 0.4, 0.6
"""But no wider than such a share of a cell: a blur that leaves nothing of a small marker's pattern leads nowhere."""
SETTLED_PX = 0.15
"""Once the corners move less than this, blur and tone are fitted too."""
ROUGH_ITERATIONS = 5
"""... or after so many steps: with too wide a blur a narrow marker's corners never come to rest."""
DONE_PX = 0.02
LARGEST_STEP_PX = 1.5
MIN_CELL_PX = 1.4
MIN_CONTRAST = 12.0
MAX_RESIDUAL, MAX_SMALL_RESIDUAL, SMALL_CELL_PX = 0.18, 0.25, 2.5
"""A shadow's edge or a hand leaves more; markers of small cells do by themselves."""
MAX_SHIFT = 0.08
"""Of the marker's side. Half a cell of the usual families is 0.06: further, and the pattern sits one cell off."""
MIN_SHIFT_LIMIT_PX = 2.5
MAX_FEW_SHIFT = 0.25
"""The same for two of the corners, if the other two stay: a finger over a corner leads a detector's lines astray."""
MORE_ITERATIONS = 14
"""... for corners that are still on their way after ``MAX_ITERATIONS``."""
MIN_SEEN = 0.7
"""The share of the sample points that must lie inside the picture."""
ACROSS_PX = np.arange(-3.0, 3.5)
"""Distances from an edge at which pixels are taken."""
COARSE_PIXELS = 200
"""Until the corners have settled roughly, so many pixels do."""
MAX_ALONG = 3
"""At how many places along an edge of one cell, at most."""
MIN_PIXELS = 60
CORRELATED = 1.05
"""What the model can't explain is alike in neighbouring pixels: corners scatter by this more than from white noise."""
FLOOR_PX = 0.004
"""Corners of noiseless rendered markers scatter by this."""
TONE_SPREAD = 0.1
"""How bent an edge's profile is expected to be (a gamma of 2.2 is about 0.2)."""


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


def refine(picture: Picture, marker: DetectedMarker, family: Family, camera: CameraModel | None = None) -> Refined:
    """Refine a marker's corners in a picture, (H, W) grey or (H, W, 3) BGR, uint8.

    ``camera`` gives the lens distortion, which bends a large marker's edges; None = straight edges. Corners are
    refused (the coarse ones come back) where the fit doesn't settle, explains the picture badly, or moves
    corners too far. Raises ValueError for an id that isn't in the family.
    """
    coarse = np.array(marker.corners, dtype=np.float64)
    pattern = pattern_of(family.bitmap(marker.id))
    lens = Lens(camera)
    fit = _Fit.of(picture, pattern, coarse, lens)
    if fit is None:
        return Refined(marker.corners, marker.kind, 0.0, float("inf"), converged=False)
    settled = fit.run()
    side = side_length(coarse)
    limit = MAX_RESIDUAL if side > SMALL_CELL_PX * pattern.cells else MAX_SMALL_RESIDUAL
    corners = lens.distort(fit.corners)
    shifts = np.linalg.norm(corners - coarse, axis=1)
    furthest = float(shifts.max())
    explained = settled and fit.contrast >= MIN_CONTRAST and fit.residual <= limit
    if not explained or not _near(shifts, side):
        doubt = tuple(np.fmin(np.where(np.isfinite(shifts), shifts, side), side).tolist())
        return Refined(marker.corners, marker.kind, furthest, fit.residual, converged=False, doubt_px=doubt)
    return Refined(_quad(corners), KIND, furthest, fit.residual, converged=True, covariance=fit.covariance())


def _quad(corners: Array) -> Quad:
    top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in corners)
    return top_left, top_right, bottom_right, bottom_left


def _near(shifts: Array, side: float) -> bool:
    """Whether corners moved (4,) px as far as a detector's may be off, and not by a cell of the pattern."""
    limit = max(MIN_SHIFT_LIMIT_PX, MAX_SHIFT * side)
    return bool(np.sort(shifts)[1] <= limit and shifts.max() <= max(limit, MAX_FEW_SHIFT * side))


def _apply(homography: Array, points: Array) -> Array:
    """A homography (3, 3) on points (N, 2)."""
    out = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(out[:, :2] / out[:, 2:])


class _Fit:
    """The least-squares problem of one marker; coordinates are centred and scaled for its conditioning.

    Unknowns: 8 of G, 3 + 3 of black and contrast (constant, along u, along v), log sigma, tone.
    """

    def __init__(self, pattern: Pattern, grey: Array, where: Array, start: Array, cell_px: float) -> None:
        self._pattern = pattern
        self._grey = grey
        self._centre = start.mean(axis=0)
        self._scale = float(np.linalg.norm(start - self._centre, axis=1).mean())
        self._where = (where - self._centre) / self._scale
        n = float(pattern.cells)
        self._square = np.array([[0.0, 0.0], [n, 0.0], [n, n], [0.0, n]])
        self._g = cv2.getPerspectiveTransform(
            ((start - self._centre) / self._scale).astype(np.float32), self._square.astype(np.float32)
        ).astype(np.float64)
        self._g /= self._g[2, 2]
        low, high = np.percentile(grey, [10, 90])
        self._light = np.array([low, 0.0, 0.0, high - low, 0.0, 0.0])
        self._sigma = float(np.clip(FIRST_SIGMA_CELLS * cell_px, LEAST_FIRST_SIGMA_PX, FIRST_SIGMA_PX))
        self._tone = 0.0
        self._coarsely = min(max(len(grey) // COARSE_PIXELS, 1), 4)
        self.residual = float("inf")
        self._normal = np.eye(16)
        self._variance = float("inf")

    @classmethod
    def of(cls, picture: Picture, pattern: Pattern, coarse: Array, lens: Lens) -> _Fit | None:
        """The problem for a marker in a picture; None where too little of it can be seen."""
        sides = np.linalg.norm(coarse - np.roll(coarse, -1, axis=0), axis=1) / pattern.cells
        if not np.isfinite(coarse).all() or sides.min() < MIN_CELL_PX:
            return None
        cell_u, cell_v = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
        along = int(np.clip(round(min(cell_u, cell_v)), 1, MAX_ALONG))
        n = float(pattern.cells)
        square = np.array([[0.0, 0.0], [n, 0.0], [n, n], [0.0, n]], dtype=np.float32)
        to_pixels = cv2.getPerspectiveTransform(square, coarse.astype(np.float32)).astype(np.float64)
        points = _apply(to_pixels, pattern.sample(along, ACROSS_PX, (cell_u, cell_v)))
        height, width = picture.shape[:2]
        pixels = np.rint(points).astype(np.int64)
        inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
        chosen = np.unique(pixels[inside, 1] * width + pixels[inside, 0])
        if inside.mean() < MIN_SEEN or len(chosen) < MIN_PIXELS:
            return None
        rows, columns = np.divmod(chosen, width)
        values = picture[rows, columns].astype(np.float64)
        grey = values if values.ndim == 1 else values @ np.array([0.114, 0.587, 0.299])
        where = lens.undistort(np.column_stack([columns, rows]).astype(np.float64))
        start = lens.undistort(coarse)
        if not (np.isfinite(where).all() and np.isfinite(start).all()):
            return None
        return cls(pattern, grey, where, start, min(cell_u, cell_v))

    @property
    def corners(self) -> Array:
        """The black square's corners (4, 2) in undistorted pixels."""
        return self._corners_of(self._g)

    @property
    def contrast(self) -> float:
        """White minus black in the middle, grey levels."""
        return float(self._light[3])

    def covariance(self) -> Array:
        """Covariance (8, 8) px^2 of the corners x y x y ... at the last step, for noise as the residual has it."""
        # A corner lies where G maps it to the square's, so its move is the one that makes up for a change of G.
        g, corners = self._g, (self.corners - self._centre) / self._scale
        by_g = np.zeros((8, 8))
        for i, ((x, y), (u, v)) in enumerate(zip(corners, self._square, strict=True)):
            slope = g[:2, :2] - np.outer((u, v), g[2, :2])
            change = np.array([[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]])
            by_g[2 * i : 2 * i + 2] = np.linalg.solve(slope, -change)
        of_g = np.linalg.inv(self._normal)[:8, :8] * self._variance
        return np.asarray(by_g @ of_g @ by_g.T * (self._scale * CORRELATED) ** 2 + np.eye(8) * FLOOR_PX**2)

    def run(self) -> bool:
        """Iterate; whether the corners settled."""
        everything = False
        start = before = self.corners
        for iteration in range(MAX_ITERATIONS + MORE_ITERATIONS):
            if iteration >= MAX_ITERATIONS and np.abs(before - start).max() < MIN_SHIFT_LIMIT_PX:
                return False
            if not self._step(everything):
                return False
            after = self.corners
            moved = float(np.linalg.norm(after - before, axis=1).max())
            before = after
            if everything and moved < DONE_PX:
                return True
            everything = everything or moved < SETTLED_PX or iteration >= ROUGH_ITERATIONS
        return False

    def _step(self, everything: bool) -> bool:
        """One Gauss-Newton step; False where the problem has no usable solution."""
        jacobian, residual = self._linearised(1 if everything else self._coarsely)
        if not everything:
            jacobian = jacobian[:, :14]
        # Cauchy weights: dirt, glare or a finger over a part of the marker shall not pull its corners.
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1.0)
        weight = 1.0 / (1.0 + (residual / (3.0 * spread)) ** 2) if everything else np.ones_like(residual)
        weighted = jacobian * weight[:, None]
        normal = weighted.T @ jacobian
        self._variance = float(weight @ residual**2) / max(float(weight.sum()) - jacobian.shape[1], 1.0)
        right = weighted.T @ residual
        if everything:
            normal[15, 15] += (spread / TONE_SPREAD) ** 2
            right[15] -= (spread / TONE_SPREAD) ** 2 * self._tone
            self._normal = normal
        normal[np.diag_indices_from(normal)] *= 1.0 + 1e-6
        try:
            step = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return False
        return bool(np.isfinite(step).all()) and self._move(step)

    def _move(self, step: Array) -> bool:
        """Apply a step, shortened where it would throw a corner far."""
        before = self.corners
        change = np.append(step[:8], 0.0).reshape(3, 3)
        for share in (1.0, 0.5, 0.25, 0.1):
            candidate = self._g + share * change
            if abs(np.linalg.det(candidate)) < 1e-9:
                continue
            if np.linalg.norm(self._corners_of(candidate) - before, axis=1).max() <= LARGEST_STEP_PX:
                self._g = candidate
                self._light = self._light + share * step[8:14]
                if len(step) > 14:
                    self._sigma = float(np.clip(self._sigma * np.exp(np.clip(step[14], -0.5, 0.5)), 0.3, 5.0))
                    self._tone = float(np.clip(self._tone + step[15], -0.45, 0.45))
                return self.contrast > 0.0
        return False

    def _corners_of(self, g: Array) -> Array:
        to_pixels = np.asarray(np.linalg.inv(g), dtype=np.float64)
        return np.asarray(_apply(to_pixels, self._square) * self._scale + self._centre)

    def _linearised(self, every: int) -> tuple[Array, Array]:
        """Of one in ``every`` pixels: Jacobian (N, 16) of the model, residual (N,) picture minus model, grey levels."""
        x, y = self._where[::every].T
        g = self._g
        w = g[2, 0] * x + g[2, 1] * y + 1.0
        u = (g[0, 0] * x + g[0, 1] * y + g[0, 2]) / w
        v = (g[1, 0] * x + g[1, 1] * y + g[1, 2]) / w
        # The blur is isotropic in the picture; across an edge of constant u it is sigma times |grad u|.
        sigma = self._sigma / self._scale
        u_x, u_y, v_x, v_y = g[0, 0] - u * g[2, 0], g[0, 1] - u * g[2, 1], g[1, 0] - v * g[2, 0], g[1, 1] - v * g[2, 1]
        along_u, along_v = np.hypot(u_x, u_y), np.hypot(v_x, v_y)
        skew = (u_x * v_x + u_y * v_y) / (along_u * along_v)
        single = (a.astype(np.float32) for a in (u, v, sigma * along_u / np.abs(w), sigma * along_v / np.abs(w), skew))
        pattern = self._pattern.at(*single)
        p = pattern.value.astype(np.float64)
        hump = 4.0 * p * (1.0 - p)
        toned = p + self._tone * hump
        across, down = u / self._pattern.cells - 0.5, v / self._pattern.cells - 0.5
        black = self._light[0] + self._light[1] * across + self._light[2] * down
        contrast = self._light[3] + self._light[4] * across + self._light[5] * down
        by_pattern = contrast * (1.0 + 4.0 * self._tone * (1.0 - 2.0 * p))
        by_u, by_v = by_pattern * pattern.by_u / w, by_pattern * pattern.by_v / w
        by_w = -(by_u * u + by_v * v)
        columns = (by_u * x, by_u * y, by_u, by_v * x, by_v * y, by_v, by_w * x, by_w * y)
        light = (np.ones_like(p), across, down, toned, toned * across, toned * down)
        jacobian = np.column_stack([*columns, *light, by_pattern * pattern.by_log_blur, contrast * hump])
        residual = self._grey[::every] - black - contrast * toned
        self.residual = float(np.sqrt(np.mean(residual**2))) / max(abs(self._light[3]), 1e-9)
        return jacobian, residual
