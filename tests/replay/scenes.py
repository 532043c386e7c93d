"""The scene of the replay tests: two boxes with a marker on five sides each, a camera with a lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide
from common.markers import family

FAMILY = family("apriltag_36h11", Path())
CAMERA = CameraModel(
    1280,
    720,
    np.array([[921.6, 0, 639.5], [0, 921.6, 359.5], [0, 0, 1.0]]),
    np.array([0.08, -0.15, 0.0005, -0.0005, 0.05]),
)
FRAME_NS = 33_333_333
APART = 37
"""Frames between two samples: over a second, so that no frame helps the next one."""


def box(name: str, first: int) -> Box:
    """A box of 400 x 300 x 300 mm with markers of 50 mm."""
    offsets = {"front": (0, 0, 0), "left": (20, -35, 0), "right": (0, 0, 0), "lid": (0, 0, 0), "back": (0, 0, 0)}
    sides = tuple(
        BoxSide(class_name, "top" if class_name == "lid" else class_name, (MarkerOnSide(first + i, 50, 10, offset),))
        for i, (class_name, offset) in enumerate(offsets.items())
    )
    return Box(name, "box", (400.0, 300.0, 300.0), sides)


BOXES = (box("box-1", 0), box("box-2", 10))
