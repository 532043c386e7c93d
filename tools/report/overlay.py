"""Draws a label over its picture: box with hidden edges dashed, window, side polygons, class and distance.

Colours and letters of the sides are those of the console; every stroke has a dark halo, so that it reads on any ground.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import EDGES
from common.labels import Label, ObjectLabel, Point, SideLabel, Window

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

SIDES: dict[str, tuple[str, Colour]] = {
    "front": ("F", (247, 195, 79)),
    "back": ("B", (5, 159, 242)),
    "left": ("L", (118, 241, 255)),
    "right": ("R", (192, 140, 217)),
    "top": ("T", (124, 169, 31)),
    "bottom": ("U", (46, 87, 228)),
}
_WHITE: Colour = (255, 255, 255)
_DARK: Colour = (31, 24, 20)
_SHIFT = 4
_FACE_CORNERS: dict[str, frozenset[int]] = {
    "front": frozenset({0, 1, 2, 3}),
    "back": frozenset({4, 5, 6, 7}),
    "left": frozenset({0, 3, 4, 7}),
    "right": frozenset({1, 2, 5, 6}),
    "top": frozenset({0, 1, 4, 5}),
    "bottom": frozenset({2, 3, 6, 7}),
}


def draw_label(bgr: Picture, label: Label) -> Picture:
    """The picture (H, W, 3) with every object of the label drawn on a copy of it."""
    out = bgr.copy()
    for item in label.objects:
        _draw_object(out, item)
    return out


def _draw_object(out: Picture, item: ObjectLabel) -> None:
    for side in item.sides:
        _fill_side(out, side)
    points = [None if corner.x is None or corner.y is None else (corner.x, corner.y) for corner in item.corners]
    facing = _facing(item, points)
    for hidden in (True, False):
        for first, second in EDGES:
            seen = any({first, second} <= _FACE_CORNERS[face] for face in facing)
            start, end = points[first], points[second]
            if seen is not hidden and start is not None and end is not None:
                _line(out, start, end, _WHITE, dash=(6, 6) if hidden else None)
    for corner in points:
        if corner is not None:
            cv2.circle(out, _pixel(corner), 3 << _SHIFT, _DARK, -1, cv2.LINE_AA, _SHIFT)
            cv2.circle(out, _pixel(corner), 2 << _SHIFT, _WHITE, -1, cv2.LINE_AA, _SHIFT)
    if item.window is not None:
        _draw_window(out, item.window)
    for side in item.sides:
        _name_side(out, side)
    anchor = item.window or item.window_unclipped
    faces = " ".join(dict.fromkeys(side.class_name for side in item.sides))
    chip(out, (anchor.x_min, anchor.y_min - 6), f"{item.name}  {faces}  {item.distance_mm:.0f} mm", _WHITE)


def _facing(item: ObjectLabel, points: Sequence[Point | None]) -> list[str]:
    """The faces turned towards the camera: their outline runs clockwise in the picture."""
    order = {
        "front": (0, 1, 2, 3),
        "back": (5, 4, 7, 6),
        "left": (4, 0, 3, 7),
        "right": (1, 5, 6, 2),
        "top": (4, 5, 1, 0),
        "bottom": (3, 2, 6, 7),
    }
    facing = []
    for face, indices in order.items():
        outline = [points[index] for index in indices]
        if any(point is None for point in outline):
            continue
        area = cv2.contourArea(np.array(outline, dtype=np.float32), oriented=True)
        if area > 0:
            facing.append(face)
    return facing or [side.face for side in item.sides]


def _fill_side(out: Picture, side: SideLabel) -> None:
    outline = np.array([_pixel(point) for point in side.polygon], dtype=np.int32)
    if len(outline) < 3:
        return
    tint = out.copy()
    cv2.fillPoly(tint, [outline], SIDES[side.face][1], cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(tint, 0.16, out, 0.84, 0, dst=out)
    cv2.polylines(out, [outline], True, SIDES[side.face][1], 2, cv2.LINE_AA, _SHIFT)


def _name_side(out: Picture, side: SideLabel) -> None:
    if not side.polygon:
        return
    letter, colour = SIDES[side.face]
    centre = np.mean(np.array(side.polygon), axis=0)
    text = f"{letter} {side.class_name}" if side.class_name != side.face else f"{letter}"
    chip(out, (float(centre[0]) - 8, float(centre[1]) + 8), text, colour)


def _draw_window(out: Picture, window: Window) -> None:
    corners = [
        (window.x_min, window.y_min),
        (window.x_max, window.y_min),
        (window.x_max, window.y_max),
        (window.x_min, window.y_max),
    ]
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        _line(out, start, end, _WHITE, dash=(14, 5))


def _line(out: Picture, start: Point, end: Point, colour: Colour, *, dash: tuple[int, int] | None) -> None:
    for first, second in _dashes(start, end, dash):
        cv2.line(out, _pixel(first), _pixel(second), _DARK, 4, cv2.LINE_AA, _SHIFT)
    for first, second in _dashes(start, end, dash):
        cv2.line(out, _pixel(first), _pixel(second), colour, 2, cv2.LINE_AA, _SHIFT)


def _dashes(start: Point, end: Point, dash: tuple[int, int] | None) -> list[tuple[Point, Point]]:
    if dash is None:
        return [(start, end)]
    begin, stop = np.array(start), np.array(end)
    length = float(np.hypot(*(stop - begin)))
    step = sum(dash)
    if length < 1e-6 or length > 20_000:
        return []
    unit = (stop - begin) / length
    out: list[tuple[Point, Point]] = []
    for offset in np.arange(0.0, length, step):
        first, second = begin + unit * offset, begin + unit * min(offset + dash[0], length)
        out.append(((float(first[0]), float(first[1])), (float(second[0]), float(second[1]))))
    return out


def chip(out: Picture, at: tuple[float, float], text: str, colour: Colour, scale: float = 0.55) -> None:
    """Text on a chip of ``colour``, its baseline at ``at``, kept inside the picture."""
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, 1)
    x = int(np.clip(at[0], 2, max(out.shape[1] - width - 8, 2)))
    y = int(np.clip(at[1], height + 6, max(out.shape[0] - base - 4, height + 6)))
    cv2.rectangle(out, (x - 4, y - height - 5), (x + width + 4, y + base + 2), colour, -1)
    cv2.putText(out, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, scale, _DARK, 1, cv2.LINE_AA)


def _pixel(point: Point) -> tuple[int, int]:
    limit = 30_000.0
    x, y = (float(np.clip(value, -limit, limit)) for value in point)
    return round(x * (1 << _SHIFT)), round(y * (1 << _SHIFT))
