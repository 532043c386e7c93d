"""How unlike each other views are: near-duplicates, tilts, distances, and which parts of the picture they cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.calibration.start import pose_of
from common.calibration.views import View
from common.geometry import CameraModel

Array = NDArray[np.float64]
SAME_SHARE = 0.01
"""Two views are the same if their corners lie apart by less than this share of the picture's diagonal."""
GRID = (8, 6)
"""Columns and rows of cells into which the picture is divided for coverage."""


@dataclass(frozen=True)
class Stance:
    """How the board stood: ``tilt_deg`` out of the picture's plane (a board parallel to it says nothing about the focal
    length, wherever it is), ``towards_deg`` the direction in the picture to which it looks (0 right, 90 down),
    ``distance_mm`` of its middle, its unit ``normal`` in the camera's frame, towards the camera."""

    tilt_deg: float
    towards_deg: float
    distance_mm: float
    normal: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Spread:
    """Of a set of views: ``cells`` (rows, columns) how many corners each cell holds; tilts and distances."""

    cells: NDArray[np.int64]
    stances: tuple[Stance, ...]

    @property
    def covered(self) -> float:
        """Share of the cells that hold a corner."""
        return float((self.cells > 0).mean())

    @property
    def greatest_tilt_deg(self) -> float:
        """The most tilted view's angle."""
        return max((stance.tilt_deg for stance in self.stances), default=0.0)

    @property
    def tilt_range_deg(self) -> float:
        """The greatest angle between two boards' normals."""
        normals = np.array([stance.normal for stance in self.stances]).reshape(-1, 3)
        if len(normals) < 2:
            return 0.0
        return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))

    @property
    def distance_ratio(self) -> float:
        """Farthest over nearest."""
        distances = [stance.distance_mm for stance in self.stances]
        return max(distances) / max(min(distances), 1e-9) if distances else 1.0


def difference(view: View, other: View) -> float:
    """Mean distance of the corners that two views share, as a share of the picture's diagonal; 1 if they share few."""
    _, mine, others = np.intersect1d(view.ids, other.ids, return_indices=True)
    if view.size != other.size or len(mine) < max(4, min(len(view.ids), len(other.ids)) // 2):
        return 1.0
    apart = np.linalg.norm(view.corners[mine] - other.corners[others], axis=1).mean()
    return float(apart / np.hypot(*view.size))


def nearest(view: View, taken: Sequence[View]) -> tuple[View | None, float]:
    """The taken view most like this one, and how different they are (see ``difference``)."""
    best = min(taken, key=lambda other: difference(view, other), default=None)
    return best, 1.0 if best is None else difference(view, best)


def is_new(view: View, taken: Sequence[View]) -> bool:
    """Whether a view adds something to those taken already."""
    return nearest(view, taken)[1] >= SAME_SHARE


def distinct(views: Sequence[View]) -> tuple[list[View], list[tuple[View, View]]]:
    """The views without near-duplicates, and each of those with the view that it repeats."""
    kept: list[View] = []
    repeats: list[tuple[View, View]] = []
    for view in views:
        like, apart = nearest(view, kept)
        if like is not None and apart < SAME_SHARE:
            repeats.append((view, like))
        else:
            kept.append(view)
    return kept, repeats


def most_different(views: Sequence[View], count: int) -> list[View]:
    """At most ``count`` views, each as unlike those before it as can be, in their first order."""
    if len(views) <= count:
        return list(views)
    chosen = [0]
    apart = np.array([difference(view, views[0]) for view in views])
    while len(chosen) < count:
        chosen.append(int(np.argmax(apart)))
        latest = views[chosen[-1]]
        apart = np.minimum(apart, [difference(view, latest) for view in views])
    return [views[index] for index in sorted(chosen)]


def stance(view: View, camera: CameraModel | None = None, pose: Array | None = None) -> Stance:
    """How the board stood in a view, by its pose or by a camera (without one: by a guess of it)."""
    if pose is None:
        pose = pose_of(view, camera or CameraModel.guess(*view.size))
    rotation = np.asarray(cv2.Rodrigues(pose[:3])[0], dtype=np.float64)
    middle = rotation @ view.points.mean(axis=0) + pose[3:]
    distance = float(np.linalg.norm(middle))
    normal = -rotation[:, 2] if rotation[:, 2] @ middle > 0 else rotation[:, 2]
    tilt = float(np.degrees(np.arccos(np.clip(-normal[2], -1, 1))))
    towards = float(np.degrees(np.arctan2(normal[1], normal[0])) % 360)
    return Stance(tilt, towards, distance, (float(normal[0]), float(normal[1]), float(normal[2])))


def spread(views: Sequence[View], camera: CameraModel | None = None, poses: Array | None = None) -> Spread:
    """Coverage, tilts and distances of a set of views of one size."""
    columns, rows = GRID
    cells = np.zeros((rows, columns), dtype=np.int64)
    for view in views:
        width, height = view.size
        across = np.clip(((view.corners[:, 0] + 0.5) / width * columns).astype(int), 0, columns - 1)
        down = np.clip(((view.corners[:, 1] + 0.5) / height * rows).astype(int), 0, rows - 1)
        np.add.at(cells, (down, across), 1)
    stances = [stance(view, camera, None if poses is None else poses[number]) for number, view in enumerate(views)]
    return Spread(cells, tuple(stances))
