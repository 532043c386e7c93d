"""Small scenes for the tests of the renderer. The checks themselves use cv2 and numpy, not the renderer's maths."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide
from common.labels import FaceName
from common.markers import Family, family

DISTORTION = np.array([0.08, -0.15, 0.0005, -0.0005, 0.05])
MATRIX = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])


def camera(distortion: np.ndarray = DISTORTION, model: str = "pinhole") -> CameraModel:
    return CameraModel(640, 480, MATRIX, distortion, model=model)


def plate(marker: MarkerOnSide, name: str = "plate") -> Box:
    return Box(name, "plate", (260.0, 200.0, 4.0), (BoxSide("front", "front", (marker,)),))


def carton(name: str, first: int, faces: tuple[FaceName, ...] = ("front", "left", "top"), size: float = 50.0) -> Box:
    sides = tuple(BoxSide(face, face, (MarkerOnSide(first + i, size, 10.0),)) for i, face in enumerate(faces))
    return Box(name, "carton", (240.0, 180.0, 200.0), sides)


@pytest.fixture(scope="session")
def tags() -> Family:
    return family("apriltag_36h11", Path())


def projected(points: np.ndarray, distortion: np.ndarray = DISTORTION, model: str = "pinhole") -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) in the camera frame, by cv2 alone."""
    zero = np.zeros(3)
    if model == "fisheye":
        pixels, _ = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), zero, zero, MATRIX, distortion)
    else:
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), zero, zero, MATRIX, distortion)
    return pixels.reshape(-1, 2)
