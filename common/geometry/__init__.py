"""Camera model, rigid poses, the cuboid object. Pure functions and frozen values on numpy arrays."""

from common.geometry.box import (
    CORNER_NAMES,
    EDGES,
    FACES,
    MARKER_CORNERS,
    Box,
    BoxSide,
    Face,
    MarkerOnSide,
    marker_points,
)
from common.geometry.camera import CameraModel
from common.geometry.difference import ModelDifference, model_difference
from common.geometry.pose import Pose
from common.geometry.sight import hidden
from common.geometry.view import view_direction

__all__ = [
    "CORNER_NAMES",
    "EDGES",
    "FACES",
    "MARKER_CORNERS",
    "Box",
    "BoxSide",
    "CameraModel",
    "Face",
    "MarkerOnSide",
    "ModelDifference",
    "Pose",
    "hidden",
    "marker_points",
    "model_difference",
    "view_direction",
]
