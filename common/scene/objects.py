"""Boxes as they are drawn: which faces and markers are seen, in which order, in what light."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, MarkerOnSide, Pose
from common.labels import FaceName
from common.scene.light import Light
from common.scene.look import face_texture
from common.scene.raster import Patch, Rectangle, draw_marker, draw_texture
from common.scene.rays import PixelRays, Region
from common.scene.texture import Pattern, Texture

Array = NDArray[np.float64]


class Patterns(Protocol):
    """What the scene needs of a marker family: ``common.markers.Family`` has it."""

    def bitmap(self, marker: int, /) -> NDArray[np.uint8]:
        """Cells (n, n) 0 black, 1 white, upright in the marker's own frame, black border included."""
        ...


class BoxDrawing:
    """Draws one box; textures are made when a face is first seen."""

    def __init__(self, box: Box, family: Patterns, seed: int) -> None:
        self.box = box
        self._seed = seed
        self._textures: dict[FaceName, Texture] = {}
        self._patterns = {
            marker.id: Pattern(family.bitmap(marker.id), margin=marker.border_mm > 0) for _, marker in box.markers()
        }

    def region(self, rays: PixelRays, pose: Pose) -> Region | None:
        """The pixels that the box and what sticks out of it can touch; ``pose``: object to camera frame."""
        found: Region | None = None
        shapes = [self._face(face, pose) for face in FACES]
        shapes += [self._sticker(side, marker, pose) for side, marker in self.box.markers()]
        for shape in shapes:
            touched = rays.region_of(shape.corners) if shape.facing else None
            if touched is not None:
                found = touched if found is None else found.union(touched)
        return found

    def draw(
        self, patch: Patch, rays: PixelRays, pose: Pose, to_scene: Pose, light: Light, index: float, *, markers: bool
    ) -> None:
        """Draw the box into a patch; ``pose``: object to camera frame, ``to_scene``: camera to scene frame."""
        seen = {face: shape for face in FACES if (shape := self._face(face, pose)).facing}
        # The broadest face last: its neighbours reach under its edges, where they can't stick out behind it.
        order = sorted(seen, key=lambda face: seen[face].cosine)
        for number, face in enumerate(order):
            under = _shared_edges(face, order[number + 1 :])
            shade = light.shade(to_scene.rotation @ seen[face].pose.rotation[:, 2], index)
            draw_texture(patch, rays, seen[face], self._texture(face), shade, under)
        if not markers:
            return
        for side, marker in self.box.markers():
            sticker = self._sticker(side, marker, pose)
            if sticker.facing:
                shade = light.shade(to_scene.rotation @ sticker.pose.rotation[:, 2], index)
                draw_marker(patch, rays, sticker, marker.size_mm, self._patterns[marker.id], shade)

    def _face(self, face: FaceName, pose: Pose) -> Rectangle:
        width, height, _ = self.box.face_size(face)
        return Rectangle(pose.after(self.box.face_pose(face)), width, height)

    def _sticker(self, side: BoxSide, marker: MarkerOnSide, pose: Pose) -> Rectangle:
        size = marker.size_mm + 2 * marker.border_mm
        return Rectangle(pose.after(self.box.marker_pose(side, marker)), size, size)

    def _texture(self, face: FaceName) -> Texture:
        if face not in self._textures:
            self._textures[face] = face_texture(self.box, face, self._seed)
        return self._textures[face]


def back_to_front(boxes: Iterable[Box], poses: Mapping[str, Pose]) -> list[str]:
    """Names of boxes that don't intersect, so ordered that none is hidden by one before it.

    ``poses``: object to camera frame. Two boxes are told apart by a face plane of either that separates them;
    only where no face does (edge against edge) the centres' distances decide.
    """
    left = {box.name: box for box in boxes if box.name in poses}
    ordered: list[str] = []
    while left:
        free = [
            name
            for name, box in left.items()
            if not any(_hides(box, poses[name], left[other], poses[other]) for other in left if other != name)
        ]
        chosen = max(free or left, key=lambda name: float(np.linalg.norm(poses[name].translation)))
        ordered.append(chosen)
        del left[chosen]
    return ordered


def _hides(front: Box, front_pose: Pose, back: Box, back_pose: Pose) -> bool:
    """Whether ``front`` is on the camera's side of ``back``."""
    if (verdict := _separated(front, front_pose, back, back_pose)) is not None:
        return verdict
    if (verdict := _separated(back, back_pose, front, front_pose)) is not None:
        return not verdict
    return float(np.linalg.norm(front_pose.translation)) < float(np.linalg.norm(back_pose.translation))


def _separated(box: Box, pose: Pose, other: Box, other_pose: Pose) -> bool | None:
    """Whether a face plane of ``box`` has all of ``other`` outside and the camera on the box's own side.

    True: the box is the nearer; False: such planes have the camera outside, too, hence the other is nearer;
    None: no face of the box separates them.
    """
    to_box = pose.inverse()
    corners = to_box.after(other_pose).apply(other.corners)
    eye = to_box.translation
    width, height, depth = box.size_mm
    half = np.array([width, depth, height]) / 2
    found: bool | None = None
    for face in FACES.values():
        normal = np.array(face.normal, dtype=np.float64)
        limit = float(np.abs(normal) @ half)
        if (corners @ normal >= limit - 1e-6).all():
            if float(eye @ normal) <= limit:
                return True
            found = False
    return found


def _shared_edges(face: FaceName, later: Iterable[FaceName]) -> frozenset[int]:
    """Edges (0 top, 1 right, 2 bottom, 3 left) at which a face meets one that is drawn later."""
    row = FACES[face]
    right, up = np.array(row.right), np.array(row.up)
    outwards = (up, right, -up, -right)
    normals = [np.array(FACES[other].normal) for other in later]
    return frozenset(
        edge for edge, direction in enumerate(outwards) if any((direction == normal).all() for normal in normals)
    )
