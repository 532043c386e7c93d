"""Which regions of the picture show a marker and must be erased. Pure.

A mask of just the black square lets the white border feed the fill and leaves a bright spot (the paper's finding),
so every marker is widened in its own plane to its border plus a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.geometry.camera import NEAR_MM
from common.labels import ErasedPolygon, LeftOut, ObjectLabel, Quad
from services.label.surfaces import PlacedBox, Region, Surface, surface_of_corners, surface_of_pose
from services.label.visibility import marker_angle, marker_hidden
from services.label.windows import along_sides, clip_near, points

Array = NDArray[np.float64]

MIN_MARGIN_PX = 3.0
MOST_SLACK_PX = 24.0
SURE_PX = 12.0
"""A pose that may be off by more says where markers may be, but not what lies before them."""
GRAZING_DEG = 91.0
"""A side seen at a grazing angle may by its pose be turned away and yet show its marker as a thin line."""
UNKNOWN_BORDER = 0.2
"""Border of a marker that the rig file doesn't know, as a share of its size: a little over one cell."""
_UNIT = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
_ALONG = 4
"""Points along each side: through a lens, straight edges are bent."""
_AROUND = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4]) / np.cos(np.pi / 8)


def regions(
    objects: Sequence[ObjectLabel],
    left_out: Sequence[LeftOut],
    boxes: Sequence[Box],
    camera: CameraModel,
    margin: float = 0.15,
) -> tuple[ErasedPolygon, ...]:
    """The polygons of ``regions_on_sides``."""
    return tuple(region.polygon for region in regions_on_sides(objects, left_out, boxes, camera, margin))


def regions_on_sides(
    objects: Sequence[ObjectLabel],
    left_out: Sequence[LeftOut],
    boxes: Sequence[Box],
    camera: CameraModel,
    margin: float = 0.15,
) -> tuple[Region, ...]:
    """What to erase in a labelled frame, and on which side; cut to the picture, so some have over four points.

    ``margin`` goes beyond the white border, as a share of the marker's size, and is at least 3 px. Every detected
    marker is erased where it was detected, known or not, and all copies of an id seen twice; every configured
    marker of an object with a pose also where the pose puts it, detected or not, unless its side is turned away
    or another object hides it. With two poses left open both count.
    """
    posed = _posed_markers(objects, boxes, camera)
    found: list[Region] = []
    sizes = {marker.id: marker for box in boxes for _, marker in box.markers()}
    for id_, corners in _detected(objects, left_out):
        marker = sizes.get(id_)
        border = UNKNOWN_BORDER if marker is None else marker.border_mm / marker.size_mm
        surface = _surface_at(id_, corners, posed)
        outline = _outline_of_corners(corners, border, margin, camera, surface)
        found += [Region(cut, surface) for cut in _cut(id_, "detected", outline, camera)]
    seen = {id(region.surface) for region in found}
    for placed in posed:
        # Where a marker was detected, that says exactly where it is; elsewhere the pose may be off.
        slack = 0.0 if id(placed.surface) in seen else placed.slack_px
        outline = _outline_of_pose(placed, margin, slack, camera)
        found += [Region(cut, placed.surface) for cut in _cut(placed.marker.id, "pose", outline, camera)]
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A configured marker that the camera can see, where a pose puts it; by how much that may be wrong."""

    box: Box
    side: BoxSide
    marker: MarkerOnSide
    pose: Pose
    surface: Surface | None
    middle: Array
    slack_px: float


def _posed_markers(objects: Sequence[ObjectLabel], boxes: Sequence[Box], camera: CameraModel) -> list[_Placed]:
    posed = [PlacedBox(box, pose, camera) for box, pose in _posed(objects, boxes)]
    slack = {label.name: _slack_px(label) for label in objects}
    found = []
    for placed in posed:
        box, pose = placed.box, placed.pose
        others = [other for other in posed if other.box is not box]
        hiding = [(other.box, other.pose) for other in others]
        for side, marker in box.markers():
            if _may_show(pose, box, side, marker) and not marker_hidden(pose, box, side, marker, hiding):
                surface = surface_of_pose(placed, side, marker, others)
                if surface is not None and slack[box.name] > SURE_PX:
                    surface = replace(surface, depth_row=None)
                middle = camera.project(pose.apply(box.marker_pose(side, marker).translation))[0][0]
                found.append(_Placed(box, side, marker, pose, surface, middle, slack[box.name]))
    return found


def _slack_px(label: ObjectLabel) -> float:
    """Three sigma of where the pose puts the worst of the object's corners; a marker on it is no worse off."""
    bar = label.quality.uncertainty
    known = [] if bar is None else [corner for corner in bar.corners_px if corner is not None]
    return min(3 * max(known), MOST_SLACK_PX) if known else 0.0


def _may_show(pose: Pose, box: Box, side: BoxSide, marker: MarkerOnSide) -> bool:
    """Whether the camera may see the marker, given that the pose may be off by a few degrees."""
    centre = pose.apply(box.marker_pose(side, marker).translation)[0]
    return bool(centre[2] > NEAR_MM) and marker_angle(pose, box, side, marker) < GRAZING_DEG


def _surface_at(id_: int, corners: Quad, posed: Sequence[_Placed]) -> Surface | None:
    """The surface of a detected marker: its side's, if the pose puts the marker where it was detected."""
    quad = np.array(corners, dtype=np.float64)
    reach = float(np.ptp(quad, axis=0).max()) / 2
    for placed in posed:
        if (
            placed.surface is not None
            and placed.marker.id == id_
            and np.linalg.norm(placed.middle - quad.mean(axis=0)) < reach
        ):
            return placed.surface
    return surface_of_corners(corners)


def _detected(objects: Sequence[ObjectLabel], left_out: Sequence[LeftOut]) -> list[tuple[int, Quad]]:
    """Every detected marker of the frame: each is in exactly one of the two."""
    sides = [(side.marker, side.marker_corners) for label in objects for side in label.sides]
    return sides + [(entry.marker, entry.corners) for entry in left_out if entry.corners is not None]


def _posed(objects: Sequence[ObjectLabel], boxes: Sequence[Box]) -> list[tuple[Box, Pose]]:
    """Each labelled box with its pose, and once more with the alternative where there is one."""
    by_name = {box.name: box for box in boxes}
    posed = []
    for label in objects:
        box = by_name.get(label.name)
        if box is None:  # found by another source than the markers
            continue
        posed.append((box, Pose.from_label(label.pose)))
        if label.quality.alternative_pose is not None:
            posed.append((box, Pose.from_label(label.quality.alternative_pose)))
    return posed


def _outline_of_corners(
    corners: Quad, border: float, margin: float, camera: CameraModel, surface: Surface | None
) -> Array | None:
    """Outline (N, 2) px of a marker widened in its plane; ``border`` and ``margin`` as shares of its size."""
    rays = camera.normalise(np.array(corners))
    if not np.isfinite(rays).all():
        # Beyond what the lens model reaches no plane is known: widen in the picture instead.
        quad = np.array(corners, dtype=np.float64)
        return _grown(quad + (quad - quad.mean(axis=0)) * 2 * (border + margin), MIN_MARGIN_PX)
    to_rays = cv2.getPerspectiveTransform(_UNIT.astype(np.float32), rays.astype(np.float32)).astype(np.float64)
    if not np.isfinite(to_rays).all():
        return _grown(np.array(corners, dtype=np.float64), MIN_MARGIN_PX)

    def at(widen: float) -> Array | None:
        flat = along_sides(_UNIT * (1 + 2 * widen), _ALONG)
        xyz = np.column_stack([flat, np.ones(len(flat))]) @ to_rays.T
        sign = np.sign(to_rays[2, 2])  # the marker's centre lies in front
        return _projected(xyz * sign * 1000.0, camera)

    return _with_margin(at(border), at(border + margin), surface)


def _outline_of_pose(placed: _Placed, margin: float, slack_px: float, camera: CameraModel) -> Array | None:
    """Outline (N, 2) px of a configured marker where the object's pose puts it."""
    box, side, marker, pose = placed.box, placed.side, placed.marker, placed.pose

    def at(widen_mm: float) -> Array | None:
        corners = clip_near(pose.apply(box.marker_corners(side, marker, widen_mm)))
        return _projected(along_sides(corners, _ALONG), camera) if len(corners) else None

    widened = at(marker.border_mm + margin * marker.size_mm)
    return _with_margin(at(marker.border_mm), widened, placed.surface, MIN_MARGIN_PX + slack_px)


def _projected(xyz: Array, camera: CameraModel) -> Array | None:
    pixels, front = camera.project(xyz)
    return pixels[front] if front.any() else None


def _with_margin(
    border: Array | None, widened: Array | None, surface: Surface | None, least_px: float = MIN_MARGIN_PX
) -> Array | None:
    """The widened outline, nowhere nearer than ``least_px`` to the border's; the rest of it stays on the marker's side.

    No marker lies beyond the edge of its side, and an object's edge is what a detector learns it by.
    """
    if border is None or widened is None:
        return None
    least = _grown(border, least_px)
    if surface is not None and surface.outline is not None:
        area, within = cv2.intersectConvexConvex(_bounded(_hull(widened)), _bounded(_hull(surface.outline)))
        widened = np.zeros((0, 2)) if area <= 0 else np.asarray(within, dtype=np.float64).reshape(-1, 2)
    return _hull(np.concatenate([widened, least]))


def _grown(outline: Array, by_px: float) -> Array:
    """A convex outline grown by ``by_px`` on all sides (Minkowski sum with an octagon around the circle)."""
    return _hull((outline[:, None, :] + _AROUND[None, :, :] * by_px).reshape(-1, 2))


def _hull(outline: Array) -> Array:
    # Far-off points would lose the near ones' digits in cv2's single precision; the picture is all that counts.
    return np.asarray(cv2.convexHull(_bounded(outline)), dtype=np.float64).reshape(-1, 2)


def _bounded(outline: Array) -> NDArray[np.float32]:
    return np.clip(outline, -1e5, 1e5).astype(np.float32)


def _cut(
    marker: int, because: Literal["detected", "pose"], outline: Array | None, camera: CameraModel
) -> list[ErasedPolygon]:
    """The part of an outline that lies in the picture (with one pixel around it, for pixels cut in half)."""
    if outline is None or len(outline) < 3 or not np.isfinite(outline).all():
        return []
    if outline.min() >= -1.0 and (outline.max(axis=0) <= (camera.width, camera.height)).all():
        return [ErasedPolygon(marker=marker, because=because, polygon=points(outline))]
    for axis, limit, sign in ((0, -1.0, 1), (0, camera.width, -1), (1, -1.0, 1), (1, camera.height, -1)):
        outline = _clip(outline, axis, limit, sign)
        if len(outline) < 3:
            return []
    return [ErasedPolygon(marker=marker, because=because, polygon=points(outline))]


def _clip(polygon: Array, axis: int, limit: float, sign: int) -> Array:
    """A convex polygon (N, 2) cut at a line parallel to an axis (Sutherland and Hodgman 1974)."""
    kept: list[Array] = []
    inside = (polygon[:, axis] - limit) * sign >= 0
    for i, here in enumerate(polygon):
        following = (i + 1) % len(polygon)
        if inside[i]:
            kept.append(here)
        if inside[i] != inside[following]:
            there = polygon[following]
            crossing = here + (there - here) * ((limit - here[axis]) / (there[axis] - here[axis]))
            crossing[axis] = limit
            kept.append(crossing)
    return np.array(kept, dtype=np.float64).reshape(-1, 2)
