"""Ground truth for the label maths that its own code did not make.

A box of 400 x 300 x 200 mm (width, height, depth). The marker corners stand here as numbers, worked out by hand
from design.md's table of side frames, and are projected by cv2.
"""

from __future__ import annotations

import cv2
import numpy as np

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.messages import DetectedMarker

BOX = Box(
    "box-1",
    "box",
    (400.0, 300.0, 200.0),
    (
        BoxSide("front", "front", (MarkerOnSide(0, 50, 10),)),
        BoxSide("left", "left", (MarkerOnSide(1, 50, 10, (20, -35, 0)),)),
        BoxSide("lid", "top", (MarkerOnSide(2, 40, 8, (0, 0, 0), 90),)),
        BoxSide("right", "right", (MarkerOnSide(3, 50, 10),)),
        BoxSide("back", "back", (MarkerOnSide(4, 50, 10),)),
    ),
)

MARKER_CORNERS = {  # object frame, mm: X right, Y away, Z up; TL TR BR BL of the marker itself
    0: [(-25, -100, 25), (25, -100, 25), (25, -100, -25), (-25, -100, -25)],
    # centre: 20 to its viewer's right is towards the front (-Y), 35 down
    1: [(-200, 5, -10), (-200, -45, -10), (-200, -45, -60), (-200, 5, -60)],
    # turned left by a quarter: its top points to the viewer's left
    2: [(-20, -20, 150), (-20, 20, 150), (20, 20, 150), (20, -20, 150)],
    3: [(200, -25, 25), (200, 25, 25), (200, 25, -25), (200, -25, -25)],
    4: [(25, 100, 25), (-25, 100, 25), (-25, 100, -25), (25, 100, -25)],
}

BOX_CORNERS = np.array(
    [
        (-200, -100, 150),
        (200, -100, 150),
        (200, -100, -150),
        (-200, -100, -150),
        (-200, 100, 150),
        (200, 100, 150),
        (200, 100, -150),
        (-200, 100, -150),
    ],
    dtype=float,
)


def camera(distortion=(0.08, -0.15, 0.0005, -0.0005, 0.05), model="pinhole") -> CameraModel:
    matrix = np.array([[921.6, 0, 639.5], [0, 921.6, 359.5], [0, 0, 1.0]])
    return CameraModel(1280, 720, matrix, np.array(distortion, dtype=float), model)


CAMERA = camera()
FISHEYE = camera((0.05, -0.02, 0.004, 0.0), "fisheye")


def looking_at(yaw_deg: float, pitch_deg: float, distance_mm: float, shift=(0.0, 0.0)) -> Pose:
    """A box before the camera: at 0, 0 its front faces the camera squarely.

    Yaw turns its left side into view (positive), pitch tilts its top into view (positive).
    """
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=float)  # X right, Z up -> y down, Y away -> z
    yaw, pitch = np.radians(-yaw_deg), np.radians(pitch_deg)
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return Pose(about_x @ about_y @ upright, np.array([*shift, distance_mm], dtype=float))


def project(points, pose: Pose, model: CameraModel = CAMERA) -> np.ndarray:
    """By cv2 alone."""
    rvec, _ = cv2.Rodrigues(pose.rotation)
    xyz = np.array(points, dtype=float).reshape(-1, 1, 3)
    if model.model == "fisheye":
        pixels, _ = cv2.fisheye.projectPoints(xyz, rvec, pose.translation, model.matrix, model.distortion)
    else:
        pixels, _ = cv2.projectPoints(xyz, rvec, pose.translation, model.matrix, model.distortion)
    return pixels.reshape(-1, 2)


def detected(id_: int, corners, kind: str = "photometric") -> DetectedMarker:
    return DetectedMarker(id=id_, corners=tuple((float(x), float(y)) for x, y in corners), kind=kind)


def seen(
    *ids: int, pose: Pose, model: CameraModel = CAMERA, noise: float = 0.0, kind: str = "photometric", seed: int = 0
) -> list[DetectedMarker]:
    """Detections of the box's markers with Gaussian corner noise (px)."""
    random = np.random.default_rng(seed)
    return [
        detected(id_, project(MARKER_CORNERS[id_], pose, model) + random.normal(0, noise, (4, 2)), kind) for id_ in ids
    ]
