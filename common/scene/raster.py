"""Draws planar rectangles into a part of a picture, exact along their edges, with depth.

Every pixel's ray is cut with the rectangle's plane; there is no intermediate picture that would have to be
distorted afterwards, so edges are as sharp as the pixels and lie where the camera model puts them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import MARKER_CORNERS, Pose
from common.scene.rays import PixelRays, Plane, Region
from common.scene.texture import Pattern, Texture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
BLACK, WHITE = 22.0, 236.0
"""Printer's black and paper white under full light, as grey values: neither clips under noise."""


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangle in space: its frame (centre, x right, y up, z to the viewer) to the camera frame, size in mm."""

    pose: Pose
    width_mm: float
    height_mm: float

    @property
    def corners(self) -> Array:
        """TL TR BR BL (4, 3) in the camera frame."""
        return self.pose.apply(MARKER_CORNERS * np.array([self.width_mm, self.height_mm, 0.0]))

    @property
    def facing(self) -> bool:
        """Whether its front is towards the camera."""
        return float(self.pose.rotation[:, 2] @ self.pose.translation) < 0.0

    @property
    def cosine(self) -> float:
        """Cosine of the angle between its normal and the direction to the camera."""
        distance = float(np.linalg.norm(self.pose.translation))
        return -float(self.pose.rotation[:, 2] @ self.pose.translation) / max(distance, 1e-9)


@dataclass(frozen=True, eq=False)
class Patch:
    """A region of the picture being drawn: ``bgr`` (h, w, 3) uint8, ``depth`` (h, w) uint16 mm or None.

    ``light`` (H, W, 3) uint8 of the whole picture: how much light arrives at each pixel, 255 = all.
    """

    region: Region
    bgr: Picture
    depth: NDArray[np.uint16] | None
    light: Picture
    pixel: float = 1.0
    """Width of the edges' ramps in px: below 1 when several passes are averaged."""


def draw_texture(
    patch: Patch,
    rays: PixelRays,
    shape: Rectangle,
    texture: Texture,
    shade: float,
    under: frozenset[int] = frozenset(),
) -> None:
    """Draw a textured rectangle.

    ``shade`` 0..1 darkens it; ``under``: edges (0 top, 1 right, 2 bottom, 3 left) beyond which a neighbour is
    drawn afterwards: there it reaches one pixel further, so that no background shines through the joint.
    """

    def paint(region: Region, inverse: Array, depth_form: Plane) -> Picture:
        jacobian = _footprint(rays, shape, region, inverse)
        picture = texture.level((jacobian[0], jacobian[1]))
        rows, columns = picture.shape[:2]
        to_texels = np.array(
            [
                [columns / shape.width_mm, 0, columns / 2 - 0.5],
                [0, -rows / shape.height_mm, rows / 2 - 0.5],
            ]
        )
        weights = to_texels @ inverse
        along_x = cv2.divide(rays.form(weights[0], region), depth_form)
        along_y = cv2.divide(rays.form(weights[1], region), depth_form)
        painted = cv2.remap(picture, along_x, along_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(painted, dtype=np.uint8)

    _draw(patch, rays, shape, shade, under, paint)


def draw_marker(
    patch: Patch, rays: PixelRays, sticker: Rectangle, size_mm: float, pattern: Pattern, shade: float
) -> None:
    """Draw a printed marker: the paper ``sticker`` with a black square of ``size_mm`` in its middle."""
    cell_mm = size_mm / pattern.cells
    to_cells = np.array([[1 / cell_mm, 0, pattern.cells / 2], [0, -1 / cell_mm, pattern.cells / 2]], dtype=np.float64)

    def paint(region: Region, inverse: Array, depth_form: Plane) -> Picture:
        jacobian = _footprint(rays, sticker, region, inverse)
        weights = to_cells @ inverse
        values = pattern.sample(
            np.asarray(cv2.divide(rays.form(weights[0], region), depth_form), dtype=np.float32),
            np.asarray(cv2.divide(rays.form(weights[1], region), depth_form), dtype=np.float32),
            (jacobian[0] * patch.pixel / cell_mm, jacobian[1] * patch.pixel / cell_mm),
        )
        grey = cv2.convertScaleAbs(values, alpha=WHITE - BLACK, beta=BLACK)
        return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)

    _draw(patch, rays, sticker, shade, frozenset(), paint)


def _draw(
    patch: Patch,
    rays: PixelRays,
    shape: Rectangle,
    shade: float,
    under: frozenset[int],
    paint: Callable[[Region, Array, Plane], Picture],
) -> None:
    """Shared by all: which pixels, what covers them how far, light, blending, depth."""
    touched = rays.region_of(shape.corners)
    region = touched.overlap(patch.region) if touched else None
    if region is None:
        return
    # Columns of the homography: a point (x, y) of the plane lies on the ray of H (x, y, 1); so the last row
    # of its inverse applied to a ray is 1 / z.
    rotation, translation = shape.pose.rotation, shape.pose.translation
    inverse = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], translation]))
    inverse_z = rays.form(inverse[2], region)
    inside = _inside(rays, shape.corners, region, frozenset())
    coverage = _inside(rays, shape.corners, region, under) if under else inside
    coverage = np.clip(coverage / np.float32(patch.pixel) + np.float32(0.5), 0.0, 1.0)
    painted = cv2.multiply(paint(region, inverse, inverse_z), patch.light[region.slices], scale=shade / 255.0)
    target = patch.bgr[region.inside(patch.region)]
    target[...] = cv2.blendLinear(painted, np.ascontiguousarray(target), coverage, 1.0 - coverage)
    if patch.depth is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.clip(np.rint(1.0 / inverse_z), 0, 65535)
        hit = (inside >= 0.0) & (inverse_z > 0.0)
        np.copyto(patch.depth[region.inside(patch.region)], depth.astype(np.uint16), where=hit)


def _inside(rays: PixelRays, corners: Array, region: Region, under: frozenset[int]) -> Plane:
    """Distance in px (float32, near the edges) of each pixel's centre from the outline, positive inside."""
    starts, ends = corners, corners[[1, 2, 3, 0]]
    planes = np.cross(starts, ends)
    planes *= np.sign(planes @ corners.mean(axis=0))[:, None]
    middles, _ = rays.camera.project((starts + ends) / 2)
    nearest: Plane | None = None
    for edge, (plane, middle) in enumerate(zip(planes, middles, strict=True)):
        (x_u, x_v), (y_u, y_v) = rays.jacobian(middle)
        slope = float(np.hypot(plane[0] * x_u + plane[1] * y_u, plane[0] * x_v + plane[1] * y_v))
        weights = plane / max(slope, 1e-12)
        if edge in under:
            weights[2] += 1.0
        distance = rays.form(weights, region)
        nearest = distance if nearest is None else np.asarray(cv2.min(nearest, distance), dtype=np.float32)
    assert nearest is not None
    return nearest


def _footprint(rays: PixelRays, shape: Rectangle, region: Region, inverse: Array) -> tuple[float, float]:
    """How many mm of the plane's x and y axes a pixel covers in the middle of what is visible of the shape."""
    middle, front = rays.camera.project(shape.pose.translation)
    pixel = middle[0] if front[0] else np.array([region.x0 + region.x1, region.y0 + region.y1]) / 2
    u = int(np.clip(round(float(pixel[0])), region.x0, region.x1 - 1))
    v = int(np.clip(round(float(pixel[1])), region.y0, region.y1 - 1))
    x, y, scale = inverse @ np.array([float(rays.x[v, u]), float(rays.y[v, u]), 1.0])
    if abs(scale) < 1e-12:
        return 1e9, 1e9
    along = (inverse[:2, :2] - np.array([[x], [y]]) / scale * inverse[2, :2]) / scale
    slopes = along @ rays.jacobian(np.array([u, v], dtype=np.float64))
    return float(np.hypot(*slopes[0])), float(np.hypot(*slopes[1]))
