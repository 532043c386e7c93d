"""The least-squares problem behind `refine`: a marker's known pattern, aligned with the pixels around its edges.

See `services.label.refine` for the model; a shadow's edge (`services.label.shade`) is a part of it where asked for.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from services.label.edge_pattern import Pattern, Values
from services.label.lens import Lens
from services.label.robust import median
from services.label.shade import PARAMETERS, Shade
from services.label.windows import following

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

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
MIN_SHIFT_LIMIT_PX = 2.5
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
CHANCE = 2.0
"""By so many times neighbours may pull together more than white noise would, by chance or a little correlation."""
FLOOR_PX, BLURRED_FLOOR_PX = 0.004, 0.15
"""Corners of noiseless rendered markers scatter by the one, and the other times (blur by cell) cubed."""
BLED_PX = 2.0
"""So near to the white border's outer edge no pixel is taken."""
TONE_SPREAD = 0.1
"""How bent an edge's profile is expected to be (a gamma of 2.2 is about 0.2)."""


def _distinct(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers (N,) in their order, each once: np.unique, which takes four times as long for so few."""
    ordered = np.sort(numbers)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])] if len(ordered) else ordered


def _furthest(moves: Array) -> float:
    """The length of the longest of moves (N, 2)."""
    return math.sqrt((moves * moves).sum(axis=1).max())


def _apply(homography: Array, points: Array) -> Array:
    """A homography (3, 3) on points (N, 2)."""
    out = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(out[:, :2] / out[:, 2:])


class PatternFit:
    """The least-squares problem of one marker; coordinates are centred and scaled for its conditioning.

    Unknowns: 8 of G, 3 + 3 of black and contrast (constant, along u, along v), 4 of a shadow if there is one, log
    sigma, tone. ``contrast`` is that in full light, ``corners`` (4, 2) the black square's in undistorted pixels.
    """

    def __init__(self, pattern: Pattern, grey: Array, where: Array, start: Array, cell_px: float) -> None:
        self._pattern = pattern
        self._grey = grey
        self._cell_px = cell_px
        self._centre = start.mean(axis=0)
        self._scale = float(np.linalg.norm(start - self._centre, axis=1).mean())
        self._where = np.ones((3, len(where)))
        self._where[:2] = ((where - self._centre) / self._scale).T
        n = float(pattern.cells)
        self._square = np.array([[0.0, 0.0], [n, 0.0], [n, n], [0.0, n]])
        self._g = cv2.getPerspectiveTransform(
            ((start - self._centre) / self._scale).astype(np.float32), self._square.astype(np.float32)
        ).astype(np.float64)
        self._g /= self._g[2, 2]
        tenth = len(grey) // 10
        low, high = np.partition(grey, (tenth, len(grey) - 1 - tenth))[[tenth, -1 - tenth]]
        self._light = np.array([low, 0.0, 0.0, high - low, 0.0, 0.0])
        self._sigma = float(np.clip(FIRST_SIGMA_CELLS * cell_px, LEAST_FIRST_SIGMA_PX, FIRST_SIGMA_PX))
        self._tone = 0.0
        self._shade: Shade | None = None
        self.corners = self._corners_of(self._g)
        self._start = (self._g, self.corners, self._light, self._sigma)
        self._coarsely = min(max(len(grey) // COARSE_PIXELS, 1), 4)
        self.residual = float("inf")
        self._normal = np.eye(16)
        self._variance = float("inf")
        self._weighted, self._misfit = np.zeros((16, len(grey))), grey

    @classmethod
    def of(
        cls, picture: Picture, pattern: Pattern, coarse: Array, lens: Lens, margin: float | None = None
    ) -> PatternFit | None:
        """None where too little of the marker can be seen; ``margin``: the border by the square's side, None: wide."""
        sides = np.linalg.norm(coarse - following(coarse), axis=1) / pattern.cells
        if not np.isfinite(coarse).all() or sides.min() < MIN_CELL_PX:
            return None
        cell_u, cell_v = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
        along = int(np.clip(round(min(cell_u, cell_v)), 1, MAX_ALONG))
        n = float(pattern.cells)
        square = np.array([[0.0, 0.0], [n, 0.0], [n, n], [0.0, n]], dtype=np.float32)
        to_pixels = cv2.getPerspectiveTransform(square, coarse.astype(np.float32)).astype(np.float64)
        cells = pattern.sample(along, ACROSS_PX, (cell_u, cell_v))
        if margin is not None:
            # What lies beyond the border isn't in the model, and blur carries it in.
            reach = np.maximum(margin * n - BLED_PX / np.array([cell_u, cell_v]), 0.0)
            within = np.abs(cells - n / 2) <= n / 2 + reach
            cells = cells[within[:, 0] & within[:, 1]]
        points = to_pixels[:, :2] @ cells.T + to_pixels[:, 2:]
        height, width = picture.shape[:2]
        x, y = np.rint(points[:2] / points[2]).astype(np.int64)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        chosen = _distinct((y * width + x)[inside])
        if inside.mean() < MIN_SEEN or len(chosen) < MIN_PIXELS:
            return None
        rows, columns = np.divmod(chosen, width)
        values = picture.reshape(height * width, -1).take(chosen, axis=0).astype(np.float64)
        grey = values[:, 0] if picture.ndim == 2 else values @ np.array([0.114, 0.587, 0.299])
        where = lens.undistort(np.column_stack([columns, rows]).astype(np.float64))
        start = lens.undistort(coarse)
        if not (np.isfinite(where).all() and np.isfinite(start).all()):
            return None
        return cls(pattern, grey, where, start, min(cell_u, cell_v))

    @property
    def contrast(self) -> float:
        """White minus black in the middle, grey levels."""
        return float(self._light[3])

    def covariance(self) -> Array:
        """Covariance (8, 8) px^2 of the corners x y x y ... at the last step, for noise as the residual has it."""
        # A corner lies where G maps it to the square's, so its move is the one that makes up for a change of G.
        g, corners = self._g, (self.corners - self._centre) / self._scale
        slopes = g[:2, :2] - self._square[:, :, None] * g[2, :2]
        change = np.zeros((4, 2, 8))
        change[:, 0, :2] = change[:, 1, 3:5] = corners
        change[:, 0, 2] = change[:, 1, 5] = 1.0
        change[:, :, 6:] = -self._square[:, :, None] * corners[:, None, :]
        by_g = np.linalg.solve(slopes, -change).reshape(8, 8)
        by_all = by_g @ np.linalg.inv(self._normal)[:8]
        white = by_all[:, :8] @ by_g.T * self._variance
        # What the model can't explain is alike in a cell's pixels (clustered sandwich: Liang, Zeger, Biometrika 1986).
        pulls = self._pulled_by_cell(by_all)
        coloured = float((pulls * pulls).sum()) / max(float(np.trace(white)), 1e-30)
        floor = math.hypot(FLOOR_PX, BLURRED_FLOOR_PX * (self._sigma / self._cell_px) ** 3)
        share = coloured if coloured > CHANCE else 1.0
        return np.asarray(white * share * self._scale**2 + np.eye(8) * floor**2)

    def _pulled_by_cell(self, by_all: Array) -> Array:
        """How far the pixels of each cell pull the corners' coordinates (8, cells); ``by_all`` (8, unknowns)."""
        at = self._g @ self._where
        tiles = np.clip(np.floor(at[:2] / at[2]), -1, self._pattern.cells).astype(np.int64) + 1
        tile = tiles[0] * (self._pattern.cells + 2) + tiles[1]
        pulls = by_all @ (self._weighted * self._misfit)
        sums = np.array([np.bincount(tile, row) for row in pulls])
        count = int(np.count_nonzero(np.bincount(tile)))
        return np.asarray(sums * math.sqrt(count / max(count - len(self._weighted), 1)))

    @property
    def dimmest(self) -> float:
        """White minus black where least light falls, grey levels."""
        return self.contrast * (1.0 - (self._shade.depth if self._shade is not None else 0.0))

    def add_shade(self, *, anew: bool) -> bool:
        """Go on with a shadow's edge, from here or (``anew``) from the start; False if the pixels show no such edge."""
        if anew:
            self._g, self.corners, self._light, self._sigma = self._start
            self._tone = 0.0
        expected = self._pattern_at(self._where)[0].value.astype(np.float64)
        shade = Shade.guess(self._where[:2].T, self._grey, expected, self._scale)
        if shade is None:
            return False
        lit = shade.on(self._where[:2].T)[0] > 1.0 - shade.depth / 2
        contrast, black = np.polyfit(expected[lit], self._grey[lit], 1)
        self._shade, self._light = shade, np.array([black, 0.0, 0.0, contrast, 0.0, 0.0])
        return True

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
            moved = _furthest(after - before)
            before = after
            if everything and moved < DONE_PX:
                return True
            everything = everything or moved < SETTLED_PX or iteration >= ROUGH_ITERATIONS
        return False

    def _step(self, everything: bool) -> bool:
        """One Gauss-Newton step; False where the problem has no usable solution."""
        jacobian, residual = self._linearised(1 if everything else self._coarsely)
        if everything:
            # Cauchy weights: dirt, glare or a finger over a part of the marker shall not pull its corners.
            spread = max(1.4826 * median(np.abs(residual)), 1.0)
            weight = 1.0 / (1.0 + (residual / (3.0 * spread)) ** 2)
            weighted = jacobian * weight
            normal, right = weighted @ jacobian.T, weighted @ residual
            normal[-1, -1] += (spread / TONE_SPREAD) ** 2
            right[-1] -= (spread / TONE_SPREAD) ** 2 * self._tone
            self._normal, self._weighted, self._misfit = normal, weighted, residual
            self._variance = float(weight @ residual**2) / max(float(weight.sum()) - len(jacobian), 1.0)
        else:
            jacobian = jacobian[:-2]
            normal, right = jacobian @ jacobian.T, jacobian @ residual
        normal.flat[:: len(normal) + 1] *= 1.0 + 1e-6
        solved, found = cv2.solve(normal, right[:, None], flags=cv2.DECOMP_LU)  # OpenCV 5 takes no vector
        step = np.asarray(found, dtype=np.float64).ravel()
        return solved and bool(np.isfinite(step).all()) and self._move(step, everything)

    def _move(self, step: Array, everything: bool) -> bool:
        """Apply a step, shortened where it would throw a corner far."""
        change = np.append(step[:8], 0.0).reshape(3, 3)
        for share in (1.0, 0.5, 0.25, 0.1):
            candidate = self._g + share * change
            if abs(cv2.determinant(candidate)) < 1e-9:
                continue
            corners = self._corners_of(candidate)
            if _furthest(corners - self.corners) <= LARGEST_STEP_PX:
                self._g, self.corners = candidate, corners
                self._light = self._light + share * step[8:14]
                if self._shade is not None:
                    self._shade = self._shade.moved(share * step[14 : 14 + PARAMETERS])
                if everything:
                    self._sigma = min(max(self._sigma * math.exp(min(max(step[-2], -0.5), 0.5)), 0.3), 5.0)
                    self._tone = min(max(self._tone + float(step[-1]), -0.45), 0.45)
                return self.contrast > 0.0
        return False

    def _corners_of(self, g: Array) -> Array:
        _, to_pixels = cv2.invert(g)
        return np.asarray(_apply(np.asarray(to_pixels), self._square) * self._scale + self._centre)

    @np.errstate(over="ignore", invalid="ignore")
    def _pattern_at(self, where: Array) -> tuple[Values, Array, Array]:
        """The blurred pattern at points (3, N), x y 1, with their u, v (2, N) in cells and the homography's w (N,).

        Corners on a line have a homography that single precision can't hold: nothing finite comes out.
        """
        cells = self._g @ where
        w = cells[2]
        cells = cells[:2] / w
        # The blur is isotropic in the picture; across an edge of constant u it is sigma times |grad u|.
        single, g = cells.astype(np.float32), self._g.astype(np.float32)
        slopes = g[:2, :2, None] - single[:, None] * g[2, :2, None]
        along = np.sqrt(slopes[:, 0] * slopes[:, 0] + slopes[:, 1] * slopes[:, 1])
        skew = (slopes[0, 0] * slopes[1, 0] + slopes[0, 1] * slopes[1, 1]) / (along[0] * along[1])
        blur = along * np.abs(self._sigma / self._scale / w).astype(np.float32)
        return self._pattern.at(single[0], single[1], blur[0], blur[1], skew), cells, w

    def _linearised(self, every: int) -> tuple[Array, Array]:
        """Of one in ``every`` pixels: Jacobian (unknowns, N), residual (N,) picture minus model, grey levels."""
        where = self._where[:, ::every]
        pattern, cells, w = self._pattern_at(where)
        p = pattern.value.astype(np.float64)
        hump = 4.0 * p * (1.0 - p)
        toned = p + self._tone * hump
        # One, and the place on the marker along u and v, -0.5 to 0.5: what black and contrast vary with.
        place = np.ones_like(where)
        place[1:] = cells / self._pattern.cells - 0.5
        contrast = self._light[3:] @ place
        by_pattern = contrast * (1.0 + 4.0 * self._tone * (1.0 - 2.0 * p))
        by_u, by_v = by_pattern * pattern.by_u / w, by_pattern * pattern.by_v / w
        by_w = -(by_u * cells[0] + by_v * cells[1])
        rows = [by_u * where, by_v * where, by_w * where[:2], place, toned * place]
        profile = [[by_pattern * pattern.by_log_blur, contrast * hump]]
        model = self._light[:3] @ place + contrast * toned
        if self._shade is None:
            jacobian = np.concatenate(rows + profile)
        else:
            light, slopes = self._shade.on(where[:2].T)
            jacobian = np.concatenate([*rows, (slopes * (model / light)[:, None]).T, *profile]) * light
            model = model * light
        residual = self._grey[::every] - model
        self.residual = math.sqrt(residual @ residual / len(residual)) / max(abs(self._light[3]), 1e-9)
        return jacobian, residual
