"""What evaluations share: the chain from a picture to its labels, and pictures as the paper's camera takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.config.models import PoseConfig
from common.geometry import Box, CameraModel, Pose
from common.labels import ObjectLabel
from common.markers import Family
from common.scene import Rendered, Scene, SceneCamera
from services.detect.markers import open_detector
from services.label.labelling import Labeller

Grey = NDArray[np.uint8]

NOISE, BLUR_PX = 3.0, 0.6
"""Of the pictures: standard deviation in grey levels, Gaussian blur of the lens."""
KEEP = PoseConfig(ambiguous="keep")
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Object frame to camera frame of a box that faces the camera squarely."""


class Chain:
    """Detector, refinement and pose as the services use them for a recorded frame, without the processes."""

    def __init__(self, boxes: Sequence[Box], family: Family, camera: CameraModel, folder: Path | None = None) -> None:
        cv2.setNumThreads(1)
        self._camera = camera
        self._detector = open_detector(family, folder or Path())
        self._labeller = Labeller(boxes, family, KEEP)

    def label(self, grey: Grey) -> tuple[ObjectLabel, ...]:
        """The objects of a picture (H, W), from it alone."""
        return self._labeller.label_once(self._detector.detect(grey), self._camera, grey).objects


def camera_of(width: int, height: int, focal_px: float) -> CameraModel:
    """A camera without distortion, its axis through the picture's middle."""
    matrix = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    return CameraModel(width, height, matrix, np.zeros(5))


@dataclass(frozen=True, eq=False)
class Shot:
    """A noise-free picture (H, W) with what was in it."""

    grey: Grey
    rendered: Rendered

    def noisy(self, random: np.random.Generator) -> Grey:
        """The picture as the sensor gives it: independent Gaussian noise of ``NOISE`` grey levels."""
        noise = random.standard_normal(self.grey.shape, dtype=np.float32) * np.float32(NOISE)
        return np.clip(np.rint(self.grey + noise), 0, 255).astype(np.uint8)


class Studio:
    """The renderer's most exact pictures of some boxes: a lens of ``BLUR_PX`` before pixels that collect light."""

    def __init__(self, boxes: Sequence[Box], family: Family, camera: CameraModel, seed: int) -> None:
        frustum = (camera.width / 2 / float(camera.matrix[0, 0]), camera.height / 2 / float(camera.matrix[1, 1]))
        self._scene = Scene(boxes, family, seed, frustum=frustum)
        self._camera = SceneCamera(self._scene, camera, quality="exact")

    def shot(self, index: int, poses: dict[str, Pose] | None = None) -> Shot:
        """A picture of the scene's path at a frame number, or of given poses (object to camera frame)."""
        rendered = self._camera.render(index, poses, noise=0.0, blur_px=BLUR_PX, depth=False)
        return Shot(np.asarray(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8), rendered)
