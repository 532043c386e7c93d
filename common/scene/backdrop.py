"""What is behind the objects: a room with a cluttered wall and a wooden table, drawn once for each camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import Pose
from common.scene.path import Room
from common.scene.raster import Patch, Picture, draw_texture
from common.scene.rays import PixelRays
from common.scene.seeds import generator
from common.scene.seen import Rectangle, look_at
from common.scene.texture import Texture

_PASSES = 2
_LONGEST_SIDE = 2400
_ALL_EDGES = frozenset(range(4))
_WALLS = ((196.0, 204.0, 206.0), (186.0, 190.0, 176.0), (206.0, 200.0, 188.0), (178.0, 194.0, 204.0))
_POSTERS = (
    (58.0, 92.0, 190.0),
    (150.0, 112.0, 46.0),
    (84.0, 138.0, 92.0),
    (70.0, 168.0, 214.0),
    (130.0, 92.0, 128.0),
    (222.0, 226.0, 224.0),
    (72.0, 66.0, 60.0),
)


@dataclass(frozen=True, eq=False)
class _Side:
    """A side of the room: its frame to the scene frame, its size, which kind of surface, its light."""

    name: str
    pose: Pose
    width_mm: float
    height_mm: float
    shade: float


class Backdrop:
    """The room of a scene; its surfaces are painted when a camera first sees them, and then kept.

    ``frustum``: tangents of half the field of view of the cameras; ``clutter``: 0 bare ... 1 much hangs and lies about.
    """

    def __init__(self, room: Room, frustum: tuple[float, float], seed: int, clutter: float) -> None:
        self._sides = _sides(room, frustum)
        self._seed = seed
        self._clutter = clutter
        self._surfaces: dict[str, Texture] = {}

    def draw(self, rays: PixelRays, to_camera: Pose, light: Picture) -> tuple[Picture, NDArray[np.uint16]]:
        """The empty scene: BGR (H, W, 3) and depth (H, W) in mm, 0 where nothing is.

        ``to_camera``: scene frame to camera frame; ``light`` (H, W, 3): 255 = all.
        """
        shape = (rays.camera.height, rays.camera.width)
        rectangles = [Rectangle(to_camera.after(side.pose), side.width_mm, side.height_mm) for side in self._sides]
        seen = [(side, flat) for side, flat in zip(self._sides, look_at(rays, rectangles), strict=True) if flat]
        total = np.zeros((*shape, 3), np.float32)
        depth = np.zeros(shape, np.uint16)
        offsets = (np.arange(_PASSES) + 0.5) / _PASSES - 0.5
        for du in offsets:
            for dv in offsets:
                through = rays.shifted(float(du), float(dv))
                patch = Patch(rays.picture, np.full((*shape, 3), 90, np.uint8), depth, light, 1.0 / _PASSES)
                for side, flat in seen:
                    draw_texture(patch, through, flat, self._surface(side), side.shade, _ALL_EDGES)
                total += patch.bgr
        # Colours are the mean of all passes, depth is that of the pixels' centres.
        depth[...] = 0
        final = Patch(rays.picture, np.zeros((*shape, 3), np.uint8), depth, light)
        for side, flat in seen:
            draw_texture(final, rays, flat, self._surface(side), side.shade, _ALL_EDGES)
        return np.rint(total / _PASSES**2).astype(np.uint8), depth

    def _surface(self, side: _Side) -> Texture:
        if side.name not in self._surfaces:
            self._surfaces[side.name] = _surface(side, self._seed, self._clutter)
        return self._surfaces[side.name]


def _sides(room: Room, frustum: tuple[float, float]) -> tuple[_Side, ...]:
    """The inner sides of a cuboid room around the objects and every camera that looks at their middle."""
    back = max(1.9 * room.far, 2.1 * room.middle, room.far + 1.5 * room.radius)
    half_width = max(1.25 * frustum[0] * back, 1.3 * (back - room.middle))
    front = 2 * room.middle - back - 0.3 * room.middle
    floor = room.reach[1] + 0.05 * room.radius
    ceiling = -max(1.3 * frustum[1] * back, 1.5 * floor)
    across, down, away = np.eye(3)
    length, height = back - front, floor - ceiling
    level, depth_middle = (floor + ceiling) / 2, (back + front) / 2

    def side(name: str, right: object, up: object, centre: object, width: float, high: float, shade: float) -> _Side:
        r, u = np.asarray(right, dtype=np.float64), np.asarray(up, dtype=np.float64)
        pose = Pose(np.column_stack([r, u, np.cross(r, u)]), np.asarray(centre, dtype=np.float64))
        return _Side(name, pose, width, high, shade)

    return (
        side("wall-back", across, -down, [0, level, back], 2 * half_width, height, 0.97),
        side("wall-front", -across, -down, [0, level, front], 2 * half_width, height, 0.82),
        side("wall-left", away, -down, [-half_width, level, depth_middle], length, height, 0.88),
        side("wall-right", -away, -down, [half_width, level, depth_middle], length, height, 0.92),
        side("table", across, away, [0, floor, depth_middle], 2 * half_width, length, 1.0),
        side("ceiling", across, -away, [0, ceiling, depth_middle], 2 * half_width, length, 0.95),
    )


def _surface(side: _Side, seed: int, clutter: float) -> Texture:
    per_mm = min(1.0, _LONGEST_SIDE / max(side.width_mm, side.height_mm))
    shape = (max(round(side.height_mm * per_mm), 8), max(round(side.width_mm * per_mm), 8))
    random = generator(seed, "room", side.name)
    if side.name == "table":
        picture = _wood(shape, per_mm, random)
        _lay_things(picture, per_mm, random, clutter)
    else:
        picture = _plaster(shape, generator(seed, "paint"), random)
        if side.name != "ceiling":
            _hang_posters(picture, random, clutter)
    return Texture(picture.clip(6, 245).astype(np.uint8), side.width_mm, side.height_mm)


def _clouds(shape: tuple[int, int], cells: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    """Smooth random values of unit spread, ``cells`` = about how many blobs down and across."""
    coarse = random.standard_normal(cells).astype(np.float32)
    return np.asarray(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float32)


def _plaster(shape: tuple[int, int], paint: np.random.Generator, random: np.random.Generator) -> NDArray[np.float32]:
    colour = np.array(_WALLS[int(paint.integers(len(_WALLS)))], dtype=np.float32)
    tone = 0.93 + 0.025 * _clouds(shape, (5, 7), random) + 0.012 * _clouds(shape, (60, 80), random)
    tone += 0.01 * _clouds(shape, (max(shape[0] // 3, 2), max(shape[1] // 3, 2)), random)
    return np.asarray(tone[:, :, None] * colour, dtype=np.float32)


def _wood(shape: tuple[int, int], per_mm: float, random: np.random.Generator) -> NDArray[np.float32]:
    """Boards side by side, each with a tone and a grain of its own."""
    rows, _ = shape
    board = max(round(180 * per_mm), 4)
    grain = (
        _clouds(shape, (max(rows // 2, 2), 9), random) * 0.035 + _clouds(shape, (max(rows // 12, 2), 5), random) * 0.05
    )
    tones = 1.0 + 0.07 * random.standard_normal(rows // board + 2).astype(np.float32)
    number = np.arange(rows) // board
    tone = tones[number][:, None] + grain
    tone[np.arange(rows) % board < max(round(3 * per_mm), 1)] *= 0.62
    return np.asarray(tone[:, :, None] * np.array((92.0, 128.0, 164.0), dtype=np.float32), dtype=np.float32)


def _around(mask: NDArray[np.float32], margin: int) -> tuple[slice, slice]:
    """The part of a mask in which something is, and ``margin`` more on each side."""
    left, top, wide, high = cv2.boundingRect((mask > 0).astype(np.uint8))
    return slice(max(top - margin, 0), top + high + margin), slice(max(left - margin, 0), left + wide + margin)


def _shadowed(picture: NDArray[np.float32], mask: NDArray[np.float32], offset: tuple[int, int], blur: float) -> None:
    """Darken what lies under the mask's soft shadow, which falls ``offset`` (down, right) beside it."""
    near = _around(mask, round(4 * blur) + max(offset))
    moved = np.roll(mask[near], offset, axis=(0, 1))
    soft = np.asarray(cv2.GaussianBlur(moved, (0, 0), blur), dtype=np.float32)
    picture[near] *= (1.0 - 0.35 * soft)[:, :, None]


def _hang_posters(picture: NDArray[np.float32], random: np.random.Generator, clutter: float) -> None:
    """Framed pictures with a few flat shapes each, and small notes."""
    rows, columns = picture.shape[:2]
    for _ in range(round(16 * clutter)):
        high = int(rows * random.uniform(0.1, 0.3))
        wide = int(high * random.uniform(0.6, 1.5))
        top = int(random.uniform(0.05, 0.78) * rows)
        left = int(random.uniform(-0.02, 0.98) * columns)
        bottom, right = min(top + high, rows - 2), min(left + wide, columns - 2)
        left = max(left, 2)
        if right - left < 12 or bottom - top < 12:
            continue
        mask = np.zeros((rows, columns), np.float32)
        mask[top:bottom, left:right] = 1.0
        _shadowed(picture, mask, (4, 5), 6.0)
        picture[top:bottom, left:right] = _poster((bottom - top, right - left), random)


def _poster(shape: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    high, wide = shape
    colours = random.permutation(len(_POSTERS))
    sheet = np.empty((high, wide, 3), np.float32)
    sheet[...] = np.array(_POSTERS[int(colours[0])], dtype=np.float32)
    for colour in colours[1 : 3 + int(random.integers(3))]:
        tone = tuple(float(v) for v in _POSTERS[int(colour)])
        place = (int(random.uniform(0, wide)), int(random.uniform(0, high)))
        size = int(min(high, wide) * random.uniform(0.12, 0.42))
        kind = int(random.integers(4))
        if kind == 0:
            cv2.circle(sheet, place, size, tone, cv2.FILLED, cv2.LINE_AA)
        elif kind == 1:
            turn = random.uniform(0, 2 * np.pi) + np.array([0, 2.1, 4.2])
            points = np.column_stack([place[0] + size * np.cos(turn), place[1] + size * np.sin(turn)])
            cv2.fillPoly(sheet, [points.astype(np.int32)], tone, cv2.LINE_AA)
        elif kind == 2:
            cv2.ellipse(sheet, place, (size, size // 3), random.uniform(0, 180), 0, 360, tone, cv2.FILLED, cv2.LINE_AA)
        else:
            for line in range(4):
                y = int(high * 0.62) + line * max(high // 14, 3)
                cv2.line(sheet, (wide // 8, y), (int(wide * random.uniform(0.5, 0.88)), y), tone, max(high // 60, 1))
    sheet += 3.0 * _clouds(shape, (4, 4), random)[:, :, None]
    frame = max(min(high, wide) // 28, 2)
    cv2.rectangle(sheet, (0, 0), (wide - 1, high - 1), (46.0, 54.0, 62.0), frame)
    return sheet


def _lay_things(picture: NDArray[np.float32], per_mm: float, random: np.random.Generator, clutter: float) -> None:
    """Plates, sheets of paper, pens: flat on the table, with soft shadows."""
    rows, columns = picture.shape[:2]
    for number in range(round(22 * clutter)):
        mask = np.zeros((rows, columns), np.float32)
        place = (int(random.uniform(0.05, 0.95) * columns), int(random.uniform(0.02, 0.9) * rows))
        turn = random.uniform(0, 180)
        if number % 3 == 0:
            radius = int(random.uniform(45, 110) * per_mm)
            cv2.circle(mask, place, max(radius, 2), 1.0, cv2.FILLED, cv2.LINE_AA)
        else:
            size = (210, 297) if number % 3 == 1 else (16, 190)
            corners = cv2.boxPoints((place, (size[0] * per_mm, size[1] * per_mm), turn))
            cv2.fillPoly(mask, [corners.astype(np.int32)], 1.0, cv2.LINE_AA)
        _shadowed(picture, mask, (3, 4), 5.0)
        colour = np.array(_POSTERS[int(random.integers(len(_POSTERS)))], dtype=np.float32)
        near = _around(mask, 0)
        picture[near] += mask[near][:, :, None] * (0.9 * colour - picture[near])
        if number % 3 == 0:
            ring = np.zeros((rows, columns), np.float32)
            cv2.circle(ring, place, max(int(radius * 0.7), 1), 1.0, max(int(3 * per_mm), 1), cv2.LINE_AA)
            picture[near] *= (1.0 - 0.15 * ring[near])[:, :, None]
