"""Views of a board with known intrinsics: corners projected exactly, noise added. No picture."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from common.calibration import View
from common.calibration.adjust import warp_shape
from common.geometry import CameraModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera whose views are made: 1280x720, mild distortion."""

    model: CameraModel = field(
        default_factory=lambda: CameraModel(
            1280,
            720,
            np.array([[905.0, 0, 652.0], [0, 908.0, 351.0], [0, 0, 1]]),
            np.array([-0.18, 0.09, 0.0008, -0.0006, -0.02]),
        )
    )
    noise_px: float = 0.15
    warp_mm: tuple[float, float] = (0.0, 0.0)
    columns: int = 9
    rows: int = 6
    square_mm: float = 25.0

    def points(self) -> Array:
        y, x = np.mgrid[1 : self.rows + 1, 1 : self.columns + 1]
        return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]) * self.square_mm

    def view(self, pose: Array, name: str, rng: np.random.Generator) -> View:
        points = self.points()
        bent = points.copy()
        extent = np.array([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])
        bent[:, 2] += warp_shape(points, extent) @ np.array(self.warp_mm)
        in_camera = bent @ np.asarray(cv2.Rodrigues(pose[:3])[0]).T + pose[3:]
        corners, _ = self.model.project(in_camera)
        corners += rng.normal(0, self.noise_px, corners.shape)
        size = (self.model.width, self.model.height)
        return View(name, size, np.arange(len(points)), points, corners, 2.5, 20.0)

    def pose(self, rng: np.random.Generator, *, tilt: float, towards: float, place: Array, share: float) -> Array:
        """The board tilted (degrees), its middle at ``place`` (0..1 of the picture), its width a share of it."""
        middle = self.points().mean(axis=0)
        axis = np.array([-np.sin(np.radians(towards)), np.cos(np.radians(towards)), 0.0])
        turn = cv2.Rodrigues(axis * np.radians(tilt))[0] @ cv2.Rodrigues(np.array([0, 0, rng.uniform(-0.3, 0.3)]))[0]
        distance = self.model.matrix[0, 0] * self.columns * self.square_mm / (share * self.model.width)
        ray = self.model.normalise(place * [self.model.width - 1, self.model.height - 1])[0]
        at = np.array([*ray, 1.0]) * distance
        return np.concatenate([cv2.Rodrigues(turn)[0].ravel(), at - turn @ middle])

    def look(
        self, rng: np.random.Generator, name: str, *, tilt: float, towards: float, place: Array, share: float
    ) -> View:
        return self.view(self.pose(rng, tilt=tilt, towards=towards, place=place, share=share), name, rng)

    def good_views(self, rng: np.random.Generator, count: int = 24) -> list[View]:
        return [view for view, _ in self.posed_views(rng, count)]

    def posed_views(self, rng: np.random.Generator, count: int = 24) -> list[tuple[View, Array]]:
        """Tilted to all sides, all over the picture, corners outside of it left out; each with its true pose."""
        found: list[tuple[View, Array]] = []
        while len(found) < count:
            pose = self.pose(
                rng,
                tilt=float(rng.uniform(5, 45)),
                towards=float(rng.uniform(0, 360)),
                place=rng.uniform(0.08, 0.92, 2),
                share=float(rng.uniform(0.25, 0.6)),
            )
            view = self.view(pose, f"{len(found):02d}", rng)
            inside = self.model.contains(view.corners)
            if inside.sum() >= 20:
                found.append((view.kept(inside), pose))
        return found

    def as_model(self, distortion: Array, model: str = "pinhole") -> Camera:
        return replace(
            self, model=CameraModel(self.model.width, self.model.height, self.model.matrix, distortion, model=model)
        )
