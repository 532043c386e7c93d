"""The seeded path on which objects move: in the picture, apart from each other, turning their marked sides here.

Scene frame: the first camera's frame (x right, y down, z away from it), mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, Pose
from common.labels import FaceName
from common.scene.seeds import generator

Array = NDArray[np.float64]
FRAMES_PER_KEY = 75.0
"""At speed 1 and 30 frames/s an object takes 2.5 s from one key to the next."""
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Object frame to camera frame of a box that stands upright with its front to the camera."""
_YAW: dict[FaceName, float] = {"front": 0.0, "right": -90.0, "back": 180.0, "left": 90.0}
_KEYS_KEPT = 16
_FIT = 1.03
_FAR = 1.6
_CLOSER, _FARTHER = 0.8, 1.25


@dataclass(frozen=True, slots=True)
class _Key:
    yaw: float
    tilt: float
    roll: float
    across: float
    down: float
    away: float

    def array(self) -> Array:
        return np.array([self.yaw, self.tilt, self.roll, self.across, self.down, self.away])


class Room:
    """Where the objects may be: cells of the picture, one an object, and a range of distances.

    ``frustum``: the tangents of half the camera's horizontal and vertical field of view. An object whose
    bounding sphere stays within its cell's cone is in the picture and can't meet another. ``distance_mm``:
    the mean distance; None chooses it so that each object fits its cell; given nearer than that, objects are
    set side by side at fixed places and partly leave the picture.
    """

    def __init__(self, boxes: Sequence[Box], frustum: tuple[float, float], distance_mm: float | None) -> None:
        self.radius = max((float(np.linalg.norm(box.size_mm)) / 2 for box in boxes), default=100.0)
        self.columns, self.rows = _grid(max(len(boxes), 1), frustum)
        self._half = np.array([frustum[0] / self.columns, frustum[1] / self.rows])
        fitting = _FIT * self.radius / float(self._half.min())
        mean = distance_mm if distance_mm is not None else fitting * (1.0 + _FAR) / 2
        self.near = mean * _CLOSER if distance_mm is not None else fitting
        self.far = mean * _FARTHER if distance_mm is not None else fitting * _FAR
        self.middle = (self.near + self.far) / 2
        self._tight = self._half * self.near < self.radius
        reach = np.where(self._tight, self.radius, self._half * self.far) * np.array([self.columns, self.rows])
        self.reach = (float(reach[0]), float(reach[1]))
        """No object is farther to the side (x, y) than this."""

    def place(self, number: int, across: float, down: float, away: float) -> Array:
        """The centre of object ``number`` for -1..1 across and down its cell and 0 (near) .. 1 (far)."""
        depth = self.near + (self.far - self.near) * away
        cell = np.array([number % self.columns, number // self.columns], dtype=np.float64)
        from_middle = cell - np.array([self.columns - 1, self.rows - 1]) / 2
        half = np.where(self._tight, self.radius, self._half * depth)
        sideways = from_middle * 2 * half + np.array([across, down]) * (half - self.radius).clip(0)
        return np.array([sideways[0], sideways[1], depth])


class Path:
    """One object's motion: a uniform cubic B-spline through seeded keys (it never stops or leaves their hull)."""

    def __init__(self, box: Box, number: int, room: Room, seed: int, speed: float) -> None:
        self._number = number
        self._room = room
        self._seed = seed
        self._speed = speed
        self._name = box.name
        marked = tuple(side.face for side in box.sides if side.markers) or ("front",)
        self._tour = _tour(tuple(face for face in _YAW if face in marked))
        self._ring = len(self._tour) == len(_YAW)
        self._sides = any(face in _YAW for face in marked)
        self._top = "top" in marked
        self._bottom = "bottom" in marked
        self._keys: dict[int, Array] = {}

    def pose(self, index: float) -> Pose:
        """Object frame to scene frame at a frame number (fractions allowed)."""
        position = index * self._speed / FRAMES_PER_KEY
        first = int(np.floor(position))
        t = position - first
        weights = np.array([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6
        keys = np.array([self._keyed(first + step) for step in (-1, 0, 1, 2)])
        yaw, tilt, roll, across, down, away = weights @ keys
        centre = self._room.place(self._number, across, down, away)
        to_camera = float(np.degrees(np.arctan2(centre[0], centre[2])))
        rotation = _about(2, roll) @ _about(1, to_camera) @ _about(0, tilt) @ _UPRIGHT @ _about(2, yaw)
        return Pose(rotation, centre)

    def _keyed(self, number: int) -> Array:
        """A key's numbers; the newest few are kept."""
        if number not in self._keys:
            self._keys[number] = self._key(number).array()
            while len(self._keys) > _KEYS_KEPT:
                self._keys.pop(next(iter(self._keys)))
        return self._keys[number]

    def _key(self, number: int) -> _Key:
        random = generator(self._seed, "path", self._name, number)
        draws = random.uniform(-1, 1, 6)
        # Each side is dwelt on for two keys: the spline would cut a single one short.
        stop = number // 2
        lap, at = divmod(stop, len(self._tour))
        yaw = self._tour[at] - 360.0 * lap * self._ring + 26.0 * draws[0]
        return _Key(
            yaw,
            self._tilt(stop, float(draws[1])),
            7.0 * float(draws[2]),
            float(np.clip(1.5 * draws[3], -1, 1)),
            float(np.clip(1.5 * draws[4], -1, 1)),
            float(np.clip(0.75 * draws[5] + 0.5, 0, 1)),
        )

    def _tilt(self, stop: int, draw: float) -> float:
        """Degrees by which the top is turned towards the camera."""
        if self._top and (not self._sides or stop % 3 == 2):
            return 56.0 + 10.0 * draw
        if self._bottom and (not (self._sides or self._top) or stop % 5 == 4):
            return -56.0 + 10.0 * draw
        return 18.0 + 15.0 * draw


def _grid(objects: int, frustum: tuple[float, float]) -> tuple[int, int]:
    """Columns and rows of cells, as large as may be."""
    choices = ((columns, ceil(objects / columns)) for columns in range(1, objects + 1))
    return max(choices, key=lambda grid: (min(frustum[0] / grid[0], frustum[1] / grid[1]), -grid[0]))


def _tour(faces: Sequence[FaceName]) -> tuple[float, ...]:
    """Yaw angles at which marked lateral faces look at the camera, so ordered that one leads to the next.

    All four: once around. Fewer: along the shortest arc that holds them, and back.
    """
    if not faces:
        return (0.0,)
    angles = sorted(_YAW[face] % 360.0 for face in faces)
    if len(angles) == len(_YAW):
        return tuple(-90.0 * step for step in range(4))
    starts = [angles[i:] + [angle + 360.0 for angle in angles[:i]] for i in range(len(angles))]
    arc = min(starts, key=lambda angles: angles[-1] - angles[0])
    return (*arc, *arc[-2:0:-1])


def _about(axis: int, degrees: float) -> Array:
    """Rotation about an axis (0 x, 1 y, 2 z)."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    angle = np.radians(degrees)
    matrix = np.eye(3)
    matrix[a, a] = matrix[b, b] = np.cos(angle)
    matrix[b, a] = np.sin(angle)
    matrix[a, b] = -np.sin(angle)
    return matrix
