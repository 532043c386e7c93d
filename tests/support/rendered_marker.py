"""One marker seen by one camera, ray-traced and supersampled: truth that shares no code with the product.

Every sub-pixel's ray is met with the marker's plane; the pattern is read from cv2's *drawing* of the marker
(turned by 180 degrees for AprilTag, which is what the real tags are), not from the code under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MATRIX = np.array([[921.6, 0, 639.5], [0, 921.6, 359.5], [0, 0, 1.0]])
SIZE = (1280, 720)
BLACK, WHITE, WALL = 30.0, 220.0, 0.35
BORDER_CELLS = 2
SUPERSAMPLING = 5
AROUND_PX = 8


@dataclass(frozen=True)
class Seen:
    """The picture (H, W) uint8 and the true corners (4, 2) px, TL TR BR BL of the marker's own frame."""

    grey: NDArray[np.uint8]
    corners: Array


def drawing(dictionary_name: str, marker: int) -> NDArray[np.uint8]:
    """The upright marker's cells in 0/1, black border included."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary_name))
    cells = dictionary.markerSize + 2
    drawn = cv2.aruco.generateImageMarker(dictionary, marker, cells) // 255
    return np.rot90(drawn, 2) if "APRILTAG" in dictionary_name else drawn


def looking_at(rng: np.random.Generator, distance_mm: float, tilt_deg: float = 50.0) -> tuple[Array, Array]:
    """A random rotation (3, 3) and translation (3,), marker frame to camera frame, that shows the marker's face."""
    spin, tilt, about = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, tilt_deg)), rng.uniform(0, 2 * np.pi)
    turned, _ = cv2.Rodrigues(np.array([0, 0, spin]))
    facing = np.diag([1.0, -1.0, -1.0])
    tilted, _ = cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0]))
    x, y = rng.uniform(-0.3, 0.3) * distance_mm, rng.uniform(-0.18, 0.18) * distance_mm
    return tilted @ facing @ turned, np.array([x, y, distance_mm])


def render(
    cells: NDArray[np.uint8],
    size_mm: float,
    pose: tuple[Array, Array],
    rng: np.random.Generator,
    *,
    distortion: Array | None = None,
    blur_px: float = 0.6,
    noise: float = 3.0,
    gamma: float = 1.0,
    border_cells: float = BORDER_CELLS,
) -> Seen:
    """The marker of ``cells`` (black square of ``size_mm``) on a grey wall, by the camera ``MATRIX``, ``SIZE``."""
    rotation, translation = pose
    lens = np.zeros(5) if distortion is None else distortion
    n = len(cells)
    corners = _project(_square(size_mm / 2), pose, lens)
    outer = _project(_square(size_mm * (0.5 + border_cells / n)), pose, lens)
    x0, y0 = np.floor(outer.min(axis=0)).astype(int) - AROUND_PX
    x1, y1 = np.ceil(outer.max(axis=0)).astype(int) + AROUND_PX + 1
    part = (np.arange(SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    xs = (np.arange(x0, x1)[:, None] + part).ravel()
    ys = (np.arange(y0, y1)[:, None] + part).ravel()
    rays = _rays(np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2), lens)
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], translation])
    on_marker = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(plane).T
    u = (on_marker[:, 0] / on_marker[:, 2] / size_mm + 0.5) * n
    v = (0.5 - on_marker[:, 1] / on_marker[:, 2] / size_mm) * n
    light = np.full(len(u), WALL, dtype=np.float32)
    light[_within(u, v, -border_cells, n + border_cells)] = 1.0
    inside = _within(u, v, 0, n)
    light[inside] = cells[v[inside].astype(int), u[inside].astype(int)]
    fine = light.reshape(len(ys), len(xs))
    if blur_px:
        fine = cv2.GaussianBlur(fine, (0, 0), blur_px * SUPERSAMPLING)
    coarse = fine.reshape(y1 - y0, SUPERSAMPLING, x1 - x0, SUPERSAMPLING).mean(axis=(1, 3))
    whole = np.full((SIZE[1], SIZE[0]), WALL)
    whole[max(y0, 0) : y1, max(x0, 0) : x1] = coarse[max(-y0, 0) : SIZE[1] - y0, max(-x0, 0) : SIZE[0] - x0]
    levels = BLACK + (WHITE - BLACK) * whole ** (1 / gamma) + rng.normal(0, noise or 1e-9, whole.shape)
    return Seen(np.clip(np.rint(levels), 0, 255).astype(np.uint8), corners)


def _rays(pixels: Array, lens: Array) -> Array:
    """x/z, y/z (N, 2) of the rays through these pixels."""
    if not lens.any():
        return (pixels - MATRIX[:2, 2]) / np.diag(MATRIX)[:2]
    at = pixels.reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 1e-8)
    if hasattr(cv2, "undistortPointsIter"):
        return cv2.undistortPointsIter(at, MATRIX, lens, np.eye(3), np.eye(3), criteria).reshape(-1, 2)
    return cv2.undistortPoints(at, MATRIX, lens, criteria=criteria).reshape(-1, 2)


def _within(u: Array, v: Array, low: float, high: float) -> NDArray[np.bool_]:
    return (u >= low) & (u < high) & (v >= low) & (v < high)


def _square(half: float) -> Array:
    return np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])


def _project(points: Array, pose: tuple[Array, Array], lens: Array) -> Array:
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(pose[0])[0], pose[1], MATRIX, lens)
    return pixels.reshape(-1, 2)
