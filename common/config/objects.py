"""What the objects of a rig mean: boxes with markers, checked against each other and against the marker family."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import get_args

import numpy as np

from common.config.models import ObjectConfig, PlacementConfig, RigConfig, SideConfig, SizeConfig
from common.config.problems import FieldPath, Problems, field_name, suggestion
from common.config.tree import Tree
from common.geometry import FACES, Box, BoxSide, MarkerOnSide
from common.labels import FaceName
from common.markers import Family

FACE_NAMES: tuple[FaceName, ...] = get_args(FaceName)
TOLERANCE_MM = 0.05
"""Sizes that differ by less agree; a marker that reaches beyond its side by less still fits."""
TYPE_DEFAULT = "box"
_INLINE = ("marker", "marker_size_mm", "border_mm", "offset_mm", "rotation_deg")

Size = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class _Claim:
    """Who has a marker id, or a name."""

    path: FieldPath
    line: int

    def __str__(self) -> str:
        return f"{field_name(self.path)} (line {self.line})"


class ObjectReader:
    """Turns ``objects`` into boxes and notes what can't be."""

    def __init__(self, tree: Tree, family: Family | None, problems: Problems) -> None:
        self._tree = tree
        self._family = family
        self._problems = problems
        self._markers: dict[int, _Claim] = {}
        self._names: dict[str, _Claim] = {}

    def read(self, config: RigConfig) -> tuple[Box, ...]:
        """The boxes; those with a mistake are noted and left out."""
        boxes = [self._box(index, one) for index, one in enumerate(config.objects)]
        return tuple(box for box in boxes if box is not None)

    def _box(self, index: int, one: ObjectConfig) -> Box | None:
        at: FieldPath = ("objects", index)
        self._claim_name((*at, "name"), one.name)
        sides: list[BoxSide] = []
        for name, side in one.sides.items():
            here: FieldPath = (*at, "sides", name)
            face = self._face(here, name, side)
            markers = self._markers_of(here, side)
            if face is not None:
                sides.append(BoxSide(name, face, markers))
        size = self._size(at, one, sides)
        if size is None:
            return None
        box = Box(one.name, one.type or TYPE_DEFAULT, size, tuple(sides))
        self._check_fit(at, one, box)
        return box

    # --- names and ids

    def _note(self, path: FieldPath, reason: str) -> None:
        """Note a mistake at ``path`` of the tree as it is now; told with the path that the file has."""
        found = self._tree.nearest(path)
        self._problems.add(found.line, found.path, reason)

    def _claim_name(self, path: FieldPath, name: str) -> None:
        first = self._names.get(name)
        if first is not None:
            self._note(path, f"'{name}' is the name of another object already: {first}; give each its own")
            return
        found = self._tree.nearest(path)
        self._names[name] = _Claim(found.path, found.line)

    def _claim_marker(self, path: FieldPath, marker: int) -> None:
        family = self._family
        if family is not None and marker >= family.ids:
            self._note(path, f"{marker} is not in {family.name}, which has the ids 0 to {family.ids - 1}")
        first = self._markers.get(marker)
        if first is not None:
            self._note(path, f"marker {marker} is claimed twice, first by {first}; each id may be used once")
            return
        found = self._tree.nearest(path)
        self._markers[marker] = _Claim(found.path, found.line)

    # --- sides

    def _face(self, path: FieldPath, name: str, side: SideConfig) -> FaceName | None:
        if side.face is not None:
            return side.face
        for face in FACE_NAMES:
            if face == name:
                return face
        if not self._problems.touch((*self._tree.nearest(path).path, "face")):
            hint = suggestion(name, FACE_NAMES)
            faces = ", ".join(FACE_NAMES)
            self._note(path, f"'{name}' is not a face{hint}; add face: with the face it is on, one of {faces}")
        return None

    def _markers_of(self, path: FieldPath, side: SideConfig) -> tuple[MarkerOnSide, ...]:
        """The markers of a side: one in place, or a list."""
        inline = [key for key in _INLINE if getattr(side, key) is not None]
        broken = self._problems.touch(self._tree.nearest(path).path)
        if side.markers is not None:
            if inline:
                self._note((*path, inline[0]), "stands beside markers: give either one marker here or a list markers")
            found = []
            for index, placement in enumerate(side.markers):
                self._claim_marker((*path, "markers", index, "marker"), placement.marker)
                found.append(_on_side(placement))
            return tuple(found)
        if side.marker is not None:
            self._claim_marker((*path, "marker"), side.marker)
        if side.marker is None or side.marker_size_mm is None:
            if not broken:
                missing = "marker_size_mm is missing" if side.marker is not None else "marker or markers is missing"
                self._note(path, f"{missing}; a side carries at least one marker with its size")
            return ()
        given = {key: getattr(side, key) for key in inline}
        return (_on_side(PlacementConfig.model_validate(given)),)

    # --- sizes

    def _size(self, at: FieldPath, one: ObjectConfig, sides: list[BoxSide]) -> Size | None:
        """Width, height, depth as seen from the front: the object's own, or as its sides give it."""
        faces = {side.class_name: side.face for side in sides}
        known: Size | None = None
        origin = "size_mm of the object"
        if one.size_mm is not None:
            known = (one.size_mm.width, one.size_mm.height, one.size_mm.depth)
        for name, side in one.sides.items():
            if side.size_mm is None or name not in faces:
                continue
            from_side = _seen_from_front(side.size_mm, faces[name])
            if known is None:
                known, origin = from_side, f"side '{name}'"
            elif any(abs(a - b) > TOLERANCE_MM for a, b in zip(from_side, known, strict=True)):
                self._note(
                    (*at, "sides", name, "size_mm"),
                    f"makes the box {_wxhxd(from_side)} (width x height x depth seen from the front), "
                    f"but {origin} says {_wxhxd(known)}",
                )
        if known is None and not self._problems.touch(self._tree.nearest(at).path):
            self._note(at, "size_mm is missing; give it for the object, or for a side as seen from that side")
        return known

    # --- markers on their sides

    def _check_fit(self, at: FieldPath, one: ObjectConfig, box: Box) -> None:
        for side in box.sides:
            path: FieldPath = (*at, "sides", side.class_name)
            listed = one.sides[side.class_name].markers is not None
            for index, marker in enumerate(side.markers):
                where: FieldPath = (*path, "markers", index) if listed else path
                reason = _beyond(box, side, marker)
                if reason:
                    self._note((*where, "marker"), reason)
        for face in FACES:
            placed = [(side, marker) for side in box.sides if side.face == face for marker in side.markers]
            for (side_a, a), (side_b, b) in combinations(placed, 2):
                if a.id != b.id and _overlap(a, b):
                    self._note(
                        (*at, "sides", side_b.class_name),
                        f"marker {b.id} overlaps marker {a.id} of side '{side_a.class_name}' on the face {face}",
                    )


def _on_side(placement: PlacementConfig) -> MarkerOnSide:
    offset = (*placement.offset_mm, 0.0)[:3]
    return MarkerOnSide(
        placement.marker,
        placement.marker_size_mm,
        placement.border_mm,
        (offset[0], offset[1], offset[2]),
        placement.rotation_deg,
    )


def _seen_from_front(size: SizeConfig, face: FaceName) -> Size:
    """A side's width, height, depth as the front's."""
    out = [0.0, 0.0, 0.0]
    for axis, value in zip(FACES[face].axes, (size.width, size.height, size.depth), strict=True):
        out[axis] = value
    return out[0], out[1], out[2]


def _wxhxd(size: Size) -> str:
    return " x ".join(f"{value:g}" for value in size)


def outline(marker: MarkerOnSide, widen_mm: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Corners (4, 2) of a marker's square in its side's frame (mm: right, up), widened all around."""
    half = marker.size_mm / 2 + widen_mm
    angle = np.radians(marker.rotation_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    square = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    return np.asarray(square @ turn.T + np.array(marker.offset_mm[:2]))


def _beyond(box: Box, side: BoxSide, marker: MarkerOnSide) -> str:
    """Why a marker with its border doesn't fit its side, empty if it does."""
    width, height, _ = box.face_size(side.face)
    corners = outline(marker, marker.border_mm)
    reach = {
        "right": corners[:, 0].max() - width / 2,
        "left": -corners[:, 0].min() - width / 2,
        "upper": corners[:, 1].max() - height / 2,
        "lower": -corners[:, 1].min() - height / 2,
    }
    edge = max(reach, key=lambda name: reach[name])
    if reach[edge] <= TOLERANCE_MM:
        return ""
    edge_length = marker.size_mm + 2 * marker.border_mm
    turned = f", turned by {marker.rotation_deg:g} degrees" if marker.rotation_deg else ""
    return (
        f"marker {marker.id} with its border ({edge_length:g} x {edge_length:g} mm{turned}) reaches "
        f"{reach[edge]:.4g} mm beyond the {edge} edge of side '{side.class_name}' ({width:g} x {height:g} mm)"
    )


def _overlap(a: MarkerOnSide, b: MarkerOnSide) -> bool:
    """Whether two black squares on one face cover common ground (separating axes of two squares)."""
    first, second = outline(a, 0.0), outline(b, 0.0)
    for quad in (first, second):
        for axis in (quad[1] - quad[0], quad[3] - quad[0]):
            unit = axis / np.linalg.norm(axis)
            p, q = first @ unit, second @ unit
            if p.max() <= q.min() + TOLERANCE_MM or q.max() <= p.min() + TOLERANCE_MM:
                return False
    return True
