"""Rendered scenes with known markers for `bench detect`: flat markers in space before a structured background.

Everything is drawn in floating-point grey, supersampled, then blurred, exposed, given noise and rounded: the
order in which a lens and a sensor do it. No code is shared with the detectors or with ``common.scene``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from common.markers import Family

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

WIDTH, HEIGHT = 1280, 720
FOCAL_PX = 921.6
CENTRE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
BLACK, WHITE = 35.0, 215.0
MARGIN_CELLS = 1.5
"""White paper around the black square, in cells."""
SUPERSAMPLING = 4
SATURATED = 255.0


@dataclass(frozen=True)
class TrueMarker:
    """A marker that is in the picture: id and corners (4, 2) px, TL TR BR BL of its own frame."""

    id: int
    corners: Array


@dataclass(frozen=True)
class Scene:
    """A picture (H, W) uint8 and all the searched family's markers in it."""

    grey: Grey
    markers: tuple[TrueMarker, ...]


@dataclass(frozen=True)
class Look:
    """What the camera does to the scene; ``motion_px`` is a streak's length, ``exposure`` a factor before clipping."""

    blur_px: float = 0.6
    noise: float = 3.0
    motion_px: float = 0.0
    exposure: float = 1.0
    shadow: float = 1.0


@dataclass(frozen=True)
class Placed:
    """A marker to be drawn: cells (n, n) 0/1, its side in space (mm), its pose in the camera's frame."""

    id: int
    cells: NDArray[np.uint8]
    size_mm: float
    rotation: Array
    translation: Array
    counts: bool = field(default=True)


def project(placed: Placed, square: Array) -> Array:
    """Points (N, 2) of the marker's plane (side 1, y up) in pixels."""
    points = np.column_stack([square * placed.size_mm, np.zeros(len(square))]) @ placed.rotation.T + placed.translation
    return np.asarray(points[:, :2] / points[:, 2:] * FOCAL_PX + CENTRE)


def unit_square(side: float = 1.0) -> Array:
    """TL TR BR BL."""
    return np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * side


def rotation(rng: np.random.Generator, tilt_deg: float) -> Array:
    """Faces the camera, spun at random about its normal, then tilted about a random axis in the picture's plane."""
    spin, about = rng.uniform(0, 2 * np.pi, 2)
    turned, _ = cv2.Rodrigues(np.array([0.0, 0.0, spin]))
    tilted, _ = cv2.Rodrigues(np.radians(tilt_deg) * np.array([np.cos(about), np.sin(about), 0.0]))
    return np.asarray(tilted @ np.diag([1.0, -1.0, -1.0]) @ turned, dtype=np.float64)


def background(rng: np.random.Generator) -> Array:
    """Soft shades at several scales and a few dozen hard-edged polygons (H, W), grey levels."""
    grey = np.full((HEIGHT, WIDTH), 120.0)
    for scale, strength in ((160, 30.0), (40, 14.0), (10, 5.0)):
        coarse = rng.normal(0, strength, (HEIGHT // scale + 3, WIDTH // scale + 3))
        grey += cv2.resize(coarse, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)[:HEIGHT, :WIDTH]
    for _ in range(40):
        centre, reach = rng.uniform((0, 0), (WIDTH, HEIGHT)), rng.uniform(6, 120)
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        corners = centre + reach * np.column_stack([np.cos(angles), np.sin(angles)])
        level = float(rng.uniform(20, 230))
        cv2.fillPoly(grey, [np.rint(corners * 16).astype(np.int32)], level, lineType=cv2.LINE_8, shift=4)
    return grey


def render(placed: list[Placed], rng: np.random.Generator, look: Look, behind: Array | None = None) -> Scene:
    """Draw the markers, later ones over earlier ones, and look at them."""
    light = background(rng) if behind is None else behind.copy()
    for one in placed:
        _draw(light, one)
        if look.shadow < 1.0:
            _cast(light, one, look.shadow, rng)
    true = tuple(TrueMarker(one.id, project(one, unit_square())) for one in placed if one.counts)
    return Scene(_photograph(light, rng, look), true)


def _draw(light: Array, placed: Placed) -> None:
    n = len(placed.cells)
    outer = project(placed, unit_square(1.0 + 2 * MARGIN_CELLS / n))
    x0, y0 = np.maximum(np.floor(outer.min(axis=0)).astype(int) - 1, 0)
    x1, y1 = np.minimum(np.ceil(outer.max(axis=0)).astype(int) + 2, (WIDTH, HEIGHT))
    part = (np.arange(SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    xs = (np.arange(x0, x1)[:, None] + part).ravel()
    ys = (np.arange(y0, y1)[:, None] + part).ravel()
    x, y = np.meshgrid((xs - CENTRE[0]) / FOCAL_PX, (ys - CENTRE[1]) / FOCAL_PX)
    plane = np.linalg.inv(np.column_stack([placed.rotation[:, 0], placed.rotation[:, 1], placed.translation]))
    w = plane[2, 0] * x + plane[2, 1] * y + plane[2, 2]
    u = ((plane[0, 0] * x + plane[0, 1] * y + plane[0, 2]) / w / placed.size_mm + 0.5) * n
    v = (0.5 - (plane[1, 0] * x + plane[1, 1] * y + plane[1, 2]) / w / placed.size_mm) * n
    paper = (np.minimum(u, v) >= -MARGIN_CELLS) & (np.maximum(u, v) < n + MARGIN_CELLS)
    padded = np.pad(placed.cells, 2, constant_values=1)
    column = np.clip(np.floor(u).astype(int) + 2, 0, n + 3)
    row = np.clip(np.floor(v).astype(int) + 2, 0, n + 3)
    inked = np.where(padded[row, column] > 0, WHITE, BLACK)
    shape = (y1 - y0, SUPERSAMPLING, x1 - x0, SUPERSAMPLING)
    cover = paper.reshape(shape).mean(axis=(1, 3))
    drawn = (inked * paper).reshape(shape).mean(axis=(1, 3))
    light[y0:y1, x0:x1] = light[y0:y1, x0:x1] * (1 - cover) + drawn


def _cast(light: Array, placed: Placed, shadow: float, rng: np.random.Generator) -> None:
    """A shadow's edge through the marker's middle, 2 px soft; it covers a square of twice the marker's reach."""
    centre = project(placed, np.zeros((1, 2)))[0]
    reach = float(np.abs(project(placed, unit_square(2.0)) - centre).max())
    x0, y0 = np.maximum((centre - reach).astype(int), 0)
    x1, y1 = np.minimum((centre + reach).astype(int), (WIDTH, HEIGHT))
    angle = rng.uniform(0, 2 * np.pi)
    x, y = np.meshgrid(np.arange(x0, x1) - centre[0], np.arange(y0, y1) - centre[1])
    beyond = np.clip((x * np.cos(angle) + y * np.sin(angle)) / 2.0 + 0.5, 0, 1)
    light[y0:y1, x0:x1] *= 1 - (1 - shadow) * beyond


def _photograph(light: Array, rng: np.random.Generator, look: Look) -> Grey:
    if look.motion_px:
        light = np.asarray(cv2.filter2D(light, -1, _streak(look.motion_px, rng.uniform(0, np.pi))), np.float64)
    exposed = np.asarray(cv2.GaussianBlur(light, (0, 0), look.blur_px)) * look.exposure
    levels = np.minimum(exposed, SATURATED) + rng.normal(0, look.noise, light.shape)
    return np.asarray(np.clip(np.rint(levels), 0, SATURATED), dtype=np.uint8)


def _streak(length: float, angle: float) -> Array:
    """A line of this length and direction as a kernel, anti-aliased, sum 1."""
    size = int(np.ceil(length)) // 2 * 2 + 3
    kernel = np.zeros((size, size))
    middle = size // 2
    for t in np.linspace(-length / 2, length / 2, 16 * size):
        x, y = middle + t * np.cos(angle), middle + t * np.sin(angle)
        i, j = int(np.floor(x)), int(np.floor(y))
        a, b = x - i, y - j
        kernel[j : j + 2, i : i + 2] += np.outer([1 - b, b], [1 - a, a])
    return np.asarray(kernel / kernel.sum())


Maker = Callable[[Family, np.random.Generator], Scene]


def _spread(
    family: Family,
    rng: np.random.Generator,
    side_px: tuple[float, float],
    tilt_deg: tuple[float, float],
    look: Look,
    ids: list[int] | None = None,
    grid: tuple[int, int] = (4, 2),
) -> Scene:
    """One marker a cell of a grid; its side in the picture and tilt drawn from the ranges."""
    chosen = ids if ids is not None else rng.choice(family.ids, grid[0] * grid[1], replace=False).tolist()
    places = [(column, row) for row in range(grid[1]) for column in range(grid[0])]
    placed = []
    for marker, (column, row) in zip(chosen, places, strict=True):
        pixel = np.array([(column + 0.5) * WIDTH / grid[0], (row + 0.5) * HEIGHT / grid[1]]) + rng.uniform(-40, 40, 2)
        distance = FOCAL_PX * 50.0 / rng.uniform(*side_px)
        at = np.append((pixel - CENTRE) / FOCAL_PX * distance, distance)
        placed.append(Placed(marker, family.bitmap(marker), 50.0, rotation(rng, rng.uniform(*tilt_deg)), at))
    return render(placed, rng, look)


def reference(family: Family, seed: int) -> Iterator[Scene]:
    """The 24 reference scenes, 72 markers of 50 mm: 400, 800, 1400 mm x tilt 10, 45 degrees x 4 seeds."""
    for distance in (400.0, 800.0, 1400.0):
        for tilt in (10.0, 45.0):
            for number in range(4):
                rng = np.random.default_rng([seed, int(distance), int(tilt), number])
                placed = []
                for marker, column in zip(rng.choice(family.ids, 3, replace=False).tolist(), (-1, 0, 1), strict=True):
                    pixel = CENTRE + np.array([column * WIDTH / 3, 0]) + rng.uniform((-60, -150), (60, 150))
                    at = np.append((pixel - CENTRE) / FOCAL_PX * distance, distance)
                    placed.append(Placed(marker, family.bitmap(marker), 50.0, rotation(rng, tilt), at))
                yield render(placed, rng, Look())


LARGE, EASY = (60.0, 100.0), (5.0, 35.0)
PLAIN = Look()
ROWS: dict[str, Callable[[Family, np.random.Generator], Scene]] = {
    "side 11-16 px": lambda f, r: _spread(f, r, (11, 16), (0, 20), PLAIN),
    "side 16-25 px": lambda f, r: _spread(f, r, (16, 25), (0, 30), PLAIN),
    "side 25-40 px": lambda f, r: _spread(f, r, (25, 40), EASY, PLAIN),
    "tilt 50": lambda f, r: _spread(f, r, LARGE, (50, 50), PLAIN),
    "tilt 60": lambda f, r: _spread(f, r, LARGE, (60, 60), PLAIN),
    "tilt 70": lambda f, r: _spread(f, r, LARGE, (70, 70), PLAIN),
    "motion 4 px": lambda f, r: _spread(f, r, LARGE, EASY, replace(PLAIN, motion_px=4)),
    "motion 8 px": lambda f, r: _spread(f, r, LARGE, EASY, replace(PLAIN, motion_px=8)),
    "motion 16 px": lambda f, r: _spread(f, r, LARGE, EASY, replace(PLAIN, motion_px=16)),
    "half shadow": lambda f, r: _spread(f, r, (30, 100), EASY, replace(PLAIN, shadow=0.35)),
    "over-exposed 30 %": lambda f, r: _spread(f, r, (30, 100), EASY, replace(PLAIN, exposure=1.3 * SATURATED / WHITE)),
    "6 equal ids": lambda f, r: _spread(f, r, (20, 80), EASY, PLAIN, [int(r.integers(f.ids))] * 6, (3, 2)),
}
"""The difficulties of issue B; each makes a scene of 8 (6) markers."""


def rows(family: Family, seed: int, scenes: int) -> Iterator[tuple[str, Scene]]:
    """``scenes`` scenes of each difficulty."""
    for index, (name, make) in enumerate(ROWS.items()):
        for number in range(scenes):
            yield name, make(family, np.random.default_rng([seed, 77, index, number]))


def look_alikes(others: list[Family], seed: int, scenes: int) -> Iterator[Scene]:
    """Scenes full of other families' markers: whatever is found there is wrong."""
    for number in range(scenes):
        rng = np.random.default_rng([seed, 88, number])
        other = others[number % len(others)]
        yield replace(_spread(other, rng, (20, 90), (0, 45), PLAIN), markers=())


def empty(seed: int, scenes: int) -> Iterator[Scene]:
    """Backgrounds alone, some with far more polygons than others have."""
    for number in range(scenes):
        rng = np.random.default_rng([seed, 99, number])
        yield render([], rng, PLAIN)


def sequence(family: Family, seed: int, frames: int) -> Iterator[Scene]:
    """Three markers that wander, turn and come nearer before a background that stays."""
    rng = np.random.default_rng([seed, 55])
    behind = background(rng)
    ids = rng.choice(family.ids, 3, replace=False).tolist()
    turns = [rotation(rng, 30.0) for _ in ids]
    phases = rng.uniform(0, 2 * np.pi, 3)
    for number in range(frames):
        placed = []
        for marker, turned, phase, column in zip(ids, turns, phases, (-1, 0, 1), strict=True):
            angle = phase + number / 12
            distance = 700 + 150 * np.sin(angle / 2)
            shift = np.array([column * WIDTH / 3 + 60 * np.cos(angle), 120 * np.sin(angle)])
            pixel = CENTRE + shift
            at = np.append((pixel - CENTRE) / FOCAL_PX * distance, distance)
            spun, _ = cv2.Rodrigues(np.array([0.0, 0.0, number / 30]))
            placed.append(Placed(marker, family.bitmap(marker), 50.0, np.asarray(spun @ turned), at))
        yield render(placed, rng, PLAIN, behind)
