"""Boxes as they are drawn: which faces and markers are seen, in which order, in what light."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES, Box, BoxSide, MarkerOnSide, Pose
from common.labels import FaceName
from common.scene.light import Light
from common.scene.look import face_texture
from common.scene.raster import Patch, draw_marker, draw_texture
from common.scene.rays import PixelRays, Region
from common.scene.seen import Rectangle, Seen, look_at
from common.scene.texture import Pattern, Texture

Array = NDArray[np.float64]


class Patterns(Protocol):
    """What the scene needs of a marker family: ``common.markers.Family`` has it."""

    def bitmap(self, marker: int, /) -> NDArray[np.uint8]:
        """Cells (n, n) 0 black, 1 white, upright in the marker's own frame, black border included."""
        ...


@dataclass(frozen=True, eq=False)
class SeenBox:
    """A box before a camera: the pixels that it and what sticks out of it can touch, what is seen, back to front."""

    region: Region
    faces: list[tuple[FaceName, Seen]]
    stickers: list[tuple[MarkerOnSide, Seen]]


class BoxDrawing:
    """Draws one box; textures are made when a face is first seen."""

    def __init__(self, box: Box, family: Patterns, seed: int) -> None:
        self.box = box
        self._seed = seed
        self._textures: dict[FaceName, Texture] = {}
        self._patterns = {
            marker.id: Pattern(family.bitmap(marker.id), margin=marker.border_mm > 0) for _, marker in box.markers()
        }

    def see(self, rays: PixelRays, pose: Pose) -> SeenBox | None:
        """How a camera sees the box; ``pose``: object to camera frame. None if it doesn't."""
        faces = {face: self._face(face, pose) for face in FACES}
        markers = self.box.markers()
        stickers = [self._sticker(side, marker, pose) for side, marker in markers]
        found = look_at(rays, [*faces.values(), *stickers])
        regions = [seen.region for seen in found if seen is not None]
        if not regions:
            return None
        # The broadest face last: its neighbours reach under its edges, where they can't stick out behind it.
        in_order = sorted(
            ((face, seen) for face, seen in zip(faces, found, strict=False) if seen is not None),
            key=lambda item: item[1].shape.cosine,
        )
        papers = [
            (marker, seen) for (_, marker), seen in zip(markers, found[len(faces) :], strict=True) if seen is not None
        ]
        return SeenBox(reduce(Region.union, regions), in_order, papers)

    def draw(
        self, patch: Patch, rays: PixelRays, seen: SeenBox, to_scene: Pose, light: Light, index: float, *, markers: bool
    ) -> None:
        """Draw the box into a patch; ``to_scene``: camera to scene frame, in which the lamp moves."""

        def shade(shape: Rectangle) -> float:
            return light.shade(to_scene.rotation @ shape.pose.rotation[:, 2], index)

        names = [face for face, _ in seen.faces]
        for number, (face, side) in enumerate(seen.faces):
            under = _shared_edges(face, names[number + 1 :])
            draw_texture(patch, rays, side, self._texture(face), shade(side.shape), under)
        if markers:
            for marker, paper in seen.stickers:
                draw_marker(patch, rays, paper, marker.size_mm, self._patterns[marker.id], shade(paper.shape))

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
