"""The cuboid as a solid: its depth in a picture without lens, and as a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, Pose
from tools.export.model import Shot, Target

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
CANVAS = 3
"""What is outside of the picture counts on a canvas this many times its size, as BOP's own tools have it."""
_TRIANGLES = (
    (0, 3, 2),
    (0, 2, 1),
    (4, 5, 6),
    (4, 6, 7),
    (0, 4, 7),
    (0, 7, 3),
    (1, 2, 6),
    (1, 6, 5),
    (0, 1, 5),
    (0, 5, 4),
    (3, 7, 6),
    (3, 6, 2),
)
"""The box's faces as triangles of corner indices, counter-clockwise as seen from outside."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A target's depth (mm along the axis, inf where it isn't) on the pixels from ``left``, ``top`` on."""

    depth: Array
    left: int
    top: int

    def in_picture(self, width: int, height: int) -> Array:
        """The depth (H, W) of the picture itself."""
        whole = np.full((height, width), np.inf)
        y0, x0 = max(self.top, 0), max(self.left, 0)
        y1 = min(self.top + self.depth.shape[0], height)
        x1 = min(self.left + self.depth.shape[1], width)
        if y0 < y1 and x0 < x1:
            whole[y0:y1, x0:x1] = self.depth[y0 - self.top : y1 - self.top, x0 - self.left : x1 - self.left]
        return whole


def solid_of(target: Target, shot: Shot) -> Solid:
    """Render a target analytically; ``shot.camera`` must be without distortion."""
    camera, window = shot.camera, target.window_unclipped
    x0 = max(int(np.floor(window.x_min)), -camera.width)
    y0 = max(int(np.floor(window.y_min)), -camera.height)
    x1 = min(int(np.ceil(window.x_max)) + 1, (CANVAS - 1) * camera.width)
    y1 = min(int(np.ceil(window.y_max)) + 1, (CANVAS - 1) * camera.height)
    x, y = np.meshgrid(np.arange(x0, max(x1, x0)), np.arange(y0, max(y1, y0)))
    pixels = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    rays: Array = np.asarray(pixels @ np.linalg.inv(camera.matrix).T, dtype=np.float64)
    return Solid(_entry(target.box, target.pose, rays).reshape(x.shape), x0, y0)


def _entry(box: Box, pose: Pose, rays: Array) -> Array:
    """Where rays (N, 3) with z = 1 from the camera enter the box: mm along the axis, inf for a miss.

    Method: slabs (Kay and Kajiya 1986).
    """
    width, height, depth = box.size_mm
    half = np.array([width, depth, height]) / 2
    eye, ways = pose.inverse().translation, rays @ pose.rotation
    ways = np.where(np.abs(ways) < 1e-12, 1e-12, ways)
    first, second = (-half - eye) / ways, (half - eye) / ways
    enters, leaves = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return np.where((enters < leaves) & (enters > 0), enters, np.inf)


def ply(box: Box, scale: float = 1.0) -> str:
    """The cuboid as ASCII PLY with normals; ``scale`` 1 is mm."""
    corners = box.corners * scale
    rows = []
    for triangle in _TRIANGLES:
        a, b, c = (corners[i] for i in triangle)
        normal = np.cross(b - a, c - a)
        normal = normal / np.linalg.norm(normal)
        rows += [" ".join(f"{value:.6g}" for value in (*corner, *normal)) for corner in (a, b, c)]
    faces = [f"3 {3 * i} {3 * i + 1} {3 * i + 2}" for i in range(len(_TRIANGLES))]
    head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join([*head, *rows, *faces]) + "\n"


def diameter(box: Box) -> float:
    """The largest distance of two of its points (mm)."""
    return float(np.linalg.norm(box.size_mm))
