"""Draws planar rectangles into a part of a picture, exact along their edges, with depth.

Every pixel's ray is cut with the rectangle's plane; there is no intermediate picture that would have to be
distorted afterwards, so edges are as sharp as the pixels and lie where the camera model puts them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.scene.coverage import REACH_PX, inner_share
from common.scene.rays import PixelRays, Plane, Region
from common.scene.seen import Seen, slopes_at
from common.scene.texture import PAD, Pattern, Texture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
_ONE, _HALF, _FARTHEST = np.float32(1.0), np.float32(0.5), np.float32(65535.0)
BLACK, WHITE = 22.0, 236.0
"""Printer's black and paper white under full light, as grey values: neither clips under noise."""


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
    seen: Seen,
    texture: Texture,
    shade: float,
    under: frozenset[int] = frozenset(),
) -> None:
    """Draw a textured rectangle.

    ``shade`` 0..1 darkens it; ``under``: edges (0 top, 1 right, 2 bottom, 3 left) beyond which a neighbour is
    drawn afterwards: there it reaches one pixel further, so that no background shines through the joint.
    """
    region = seen.region.overlap(patch.region)
    if region is None:
        return
    width, height = seen.shape.width_mm, seen.shape.height_mm
    picture = texture.level((seen.footprint[0] * patch.pixel, seen.footprint[1] * patch.pixel))
    rows, columns = picture.shape[0] - 2 * PAD, picture.shape[1] - 2 * PAD
    to_texels = np.array([[columns / width, 0, columns / 2 - 0.5 + PAD], [0, -rows / height, rows / 2 - 0.5 + PAD]])
    inverse_z = rays.form(seen.inverse[2], region)
    along_x, along_y = _plane_coordinates(rays, to_texels @ seen.inverse, inverse_z, region)
    painted = cv2.remap(picture, along_x, along_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    _lay(patch, rays, seen, region, np.asarray(painted, dtype=np.uint8), inverse_z, shade, under)


def draw_marker(patch: Patch, rays: PixelRays, seen: Seen, size_mm: float, pattern: Pattern, shade: float) -> None:
    """Draw a printed marker: ``seen`` is the paper, with a black square of ``size_mm`` in its middle."""
    region = seen.region.overlap(patch.region)
    if region is None:
        return
    cell_mm = size_mm / pattern.cells
    to_cells = np.array([[1 / cell_mm, 0, pattern.cells / 2], [0, -1 / cell_mm, pattern.cells / 2]])
    inverse_z = rays.form(seen.inverse[2], region)
    across, down = _plane_coordinates(rays, to_cells @ seen.inverse, inverse_z, region)
    crossings = (pattern.crossings - pattern.cells / 2) * [cell_mm, -cell_mm]
    slopes = to_cells[:, :2] @ slopes_at(rays, seen, crossings) * patch.pixel
    values = pattern.sample(across, down, slopes)
    grey = cv2.convertScaleAbs(values, alpha=WHITE - BLACK, beta=BLACK)
    painted = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    _lay(patch, rays, seen, region, painted, inverse_z, shade, frozenset())


def _plane_coordinates(rays: PixelRays, weights: Array, inverse_z: Plane, region: Region) -> tuple[Plane, Plane]:
    """Where each pixel's ray meets the plane, in the units of ``weights`` (2, 3)."""
    across, down = (cv2.divide(rays.form(row, region), inverse_z) for row in weights)
    return np.asarray(across, dtype=np.float32), np.asarray(down, dtype=np.float32)


def _lay(
    patch: Patch,
    rays: PixelRays,
    seen: Seen,
    region: Region,
    painted: Picture,
    inverse_z: Plane,
    shade: float,
    under: frozenset[int],
) -> None:
    """Put painted pixels into the patch: lit, blended at the edges, with their depth."""
    distances = [rays.form(line, region) for line in seen.edges]
    reached = _least(distances)
    lit = np.asarray(cv2.multiply(painted, patch.light[region.slices], scale=shade / 255.0), dtype=np.uint8)
    target = patch.bgr[region.inside(patch.region)]
    if patch.depth is not None:
        with np.errstate(divide="ignore", invalid="ignore"):  # outside of the rectangle, where nothing is copied
            depth = np.clip(_ONE / inverse_z, 0.0, _FARTHEST)
            depth = (depth + _HALF).astype(np.uint16)
        cv2.copyTo(depth, (reached >= 0.0).view(np.uint8), patch.depth[region.inside(patch.region)])
    if under:
        for edge in under:
            distances[edge] += 1.0
        reached = _least(distances)
    # Nearly all pixels are covered entirely or not at all.
    reach = REACH_PX * patch.pixel
    cv2.copyTo(lit, (reached >= reach).view(np.uint8), target)
    flat = np.flatnonzero((reached > -reach) & (reached < reach))
    rows, columns = np.divmod(flat, reached.shape[1])
    from_edges = np.stack([distance.ravel().take(flat) for distance in distances])
    across, down = seen.normals[from_edges.argmin(axis=0)].astype(np.float32).T
    share = inner_share(from_edges.min(axis=0) / np.float32(patch.pixel), across, down)[:, None]
    below = target[rows, columns]
    mixed = below + share * (lit.reshape(-1, 3)[flat].astype(np.float32) - below)
    target[rows, columns] = (mixed + np.float32(0.5)).astype(np.uint8)


def _least(planes: list[Plane]) -> Plane:
    least = planes[0]
    for plane in planes[1:]:
        least = np.asarray(cv2.min(least, plane), dtype=np.float32)
    return least
