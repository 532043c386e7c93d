"""What the sides of a box look like: each has features of its own, as on a real carton, beside its markers.

front: lettering; back: a red logo; left and right: one faint stripe each, nearly alike; top: a strip of tape;
bottom: a seam. Boxes of the same type look the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.geometry import MARKER_CORNERS, Box
from common.labels import FaceName
from common.scene.seeds import generator
from common.scene.texture import Texture

Picture = NDArray[np.uint8]
Colour = tuple[float, float, float]
_MOST_TEXELS = 1000
_FINEST_PER_MM = 5.0
_RED: Colour = (44.0, 40.0, 196.0)
_CARTONS: tuple[tuple[Colour, Colour], ...] = (
    # BGR of the board, BGR of what is printed on it
    ((128.0, 168.0, 202.0), (38.0, 48.0, 66.0)),
    ((214.0, 220.0, 222.0), (120.0, 74.0, 32.0)),
    ((172.0, 132.0, 84.0), (240.0, 236.0, 228.0)),
    ((116.0, 158.0, 122.0), (36.0, 62.0, 34.0)),
    ((150.0, 186.0, 226.0), (60.0, 40.0, 28.0)),
)


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle on a face in mm from its centre: x right, y up."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Along x, mm."""
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        """Along y, mm."""
        return self.y1 - self.y0


def face_texture(box: Box, face: FaceName, seed: int) -> Texture:
    """The picture of a box's side, without its markers."""
    width, height, _ = box.face_size(face)
    per_mm = min(_FINEST_PER_MM, _MOST_TEXELS / max(width, height))
    sheet = _Sheet(width, height, per_mm)
    board, ink = _CARTONS[int(generator(seed, "carton", box.type).integers(len(_CARTONS)))]
    sheet.fill(board, generator(seed, "board", box.type, face))
    area = free_area(box, face)
    if face == "front":
        _lettering(sheet, area, box.type, ink)
    elif face == "back":
        _logo(sheet, area)
    elif face in ("left", "right"):
        _stripe(sheet, board, 0.32 if face == "left" else 0.24)
    elif face == "top":
        _tape(sheet, board)
    else:
        _seam(sheet, board)
    sheet.wear()
    return Texture(sheet.picture(), width, height)


def free_area(box: Box, face: FaceName) -> Area:
    """The largest rectangle of a side beside its markers: a marker must not cover what the side is known by."""
    width, height, _ = box.face_size(face)
    margin = 0.06 * min(width, height)
    whole = Area(-width / 2 + margin, -height / 2 + margin, width / 2 - margin, height / 2 - margin)
    stickers = []
    for side, marker in box.markers():
        if side.face == face:
            corners = box.face_pose(face).inverse().apply(box.marker_corners(side, marker, marker.border_mm))
            stickers.append(corners[:, :2])
    if not stickers:
        return whole
    points = np.concatenate(stickers)
    (left, low), (right, high) = points.min(axis=0) - margin / 2, points.max(axis=0) + margin / 2
    around = (
        Area(whole.x0, high, whole.x1, whole.y1),
        Area(whole.x0, whole.y0, whole.x1, low),
        Area(whole.x0, whole.y0, left, whole.y1),
        Area(right, whole.y0, whole.x1, whole.y1),
    )
    return max(around, key=lambda area: min(area.width, 3.0 * area.height))


class _Sheet:
    """A face's picture while it is drawn, in float; drawing is done in mm from the face's centre, y up."""

    def __init__(self, width: float, height: float, per_mm: float) -> None:
        self.width, self.height, self.per_mm = width, height, per_mm
        self.shape = (max(round(height * per_mm), 8), max(round(width * per_mm), 8))
        self.pixels: NDArray[np.float32] = np.zeros((*self.shape, 3), np.float32)

    def fill(self, colour: Colour, random: np.random.Generator) -> None:
        """Board with the unevenness of paper: large blotches, fibres, a hint of corrugation."""
        rows, columns = self.shape
        blotches = cv2.resize(
            random.standard_normal((6, 8)).astype(np.float32), (columns, rows), interpolation=cv2.INTER_CUBIC
        )
        fibres = cv2.GaussianBlur(random.standard_normal(self.shape).astype(np.float32), (0, 0), 2.0, sigmaY=0.6)
        waves = np.sin(np.arange(columns, dtype=np.float32) / self.per_mm * np.float32(2 * np.pi / 7.0))
        tone = 1.0 + 0.015 * blotches + 0.03 * fibres + 0.008 * waves[None, :]
        self.pixels = np.asarray(tone[:, :, None] * np.array(colour, dtype=np.float32), dtype=np.float32)

    def mask(self, polygons: list[NDArray[np.float64]], width_mm: float | None = None) -> NDArray[np.float32]:
        """Coverage 0..1 of polygons (N, 2) in mm, or of their outlines of a width; finely anti-aliased."""
        canvas = np.zeros(self.shape, np.uint8)
        shift = 4
        for polygon in polygons:
            texels = np.column_stack([polygon[:, 0] + self.width / 2, self.height / 2 - polygon[:, 1]]) * self.per_mm
            points = np.rint((texels - 0.5) * (1 << shift)).astype(np.int32)
            if width_mm is None:
                cv2.fillPoly(canvas, [points], 255, cv2.LINE_AA, shift)
            else:
                thick = max(round(width_mm * self.per_mm), 1)
                cv2.polylines(canvas, [points], True, 255, thick, cv2.LINE_AA, shift)
        return canvas.astype(np.float32) / np.float32(255)

    def print(self, mask: NDArray[np.float32], colour: Colour, strength: float = 1.0) -> None:
        """Ink of a colour where the mask is."""
        share = (mask * np.float32(strength))[:, :, None]
        self.pixels += share * (np.array(colour, dtype=np.float32) - self.pixels)

    def text(self, area: Area, text: str, colour: Colour, *, heavy: bool) -> None:
        """A line of text as large as fits the area, in its middle."""
        font = cv2.FONT_HERSHEY_DUPLEX if heavy else cv2.FONT_HERSHEY_SIMPLEX
        (wide, high), base = cv2.getTextSize(text, font, 4.0, 9 if heavy else 5)
        line = np.zeros((high + base + 24, wide + 24), np.uint8)
        cv2.putText(line, text, (12, high + 12), font, 4.0, 255, 9 if heavy else 5, cv2.LINE_AA)
        scale = min(area.width / line.shape[1], area.height / line.shape[0]) * self.per_mm
        size = (max(round(line.shape[1] * scale), 1), max(round(line.shape[0] * scale), 1))
        small = cv2.resize(line, size, interpolation=cv2.INTER_AREA)
        column = round(((area.x0 + area.x1) / 2 + self.width / 2) * self.per_mm - size[0] / 2)
        row = round((self.height / 2 - (area.y0 + area.y1) / 2) * self.per_mm - size[1] / 2)
        mask = np.zeros(self.shape, np.float32)
        row, column = max(row, 0), max(column, 0)
        target = mask[row : row + size[1], column : column + size[0]]
        target[...] = small[: target.shape[0], : target.shape[1]] / np.float32(255)
        self.print(mask, colour)

    def wear(self) -> None:
        """Darker towards the edges, a thin bright line where the board is scuffed."""
        rows, columns = self.shape
        y = np.minimum(np.arange(rows), np.arange(rows)[::-1]).astype(np.float32) / np.float32(self.per_mm)
        x = np.minimum(np.arange(columns), np.arange(columns)[::-1]).astype(np.float32) / np.float32(self.per_mm)
        near = np.minimum(y[:, None], x[None, :])
        reach = np.float32(0.035 * min(self.width, self.height))
        self.pixels *= (1.0 - 0.16 * np.exp(-near / reach))[:, :, None]
        self.pixels *= (1.0 + 0.10 * np.exp(-near / np.float32(0.8)))[:, :, None]

    def picture(self) -> Picture:
        return np.rint(self.pixels).clip(8, 245).astype(np.uint8)


def _lettering(sheet: _Sheet, area: Area, word: str, ink: Colour) -> None:
    split = area.y0 + 0.34 * area.height
    sheet.text(Area(area.x0, split, area.x1, area.y1), word.upper()[:14], ink, heavy=True)
    small = Area(area.x0, area.y0, area.x1, split - 0.08 * area.height)
    sheet.text(small, "HANDLE WITH CARE", ink, heavy=False)


def _logo(sheet: _Sheet, area: Area) -> None:
    size = 0.46 * min(area.width, area.height)
    middle = np.array([(area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2])
    turn = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    disc = sheet.mask([middle + size * circle])
    peak = np.array([[-0.66, -0.36], [-0.24, 0.5], [0.06, 0.02], [0.24, 0.3], [0.66, -0.36]])
    sheet.print(disc, _RED)
    sheet.print(sheet.mask([middle + 0.86 * size * circle], 0.05 * size), (235.0, 238.0, 240.0))
    sheet.print(sheet.mask([middle + size * peak]), (235.0, 238.0, 240.0))


def _band(sheet: _Sheet, low: float, high: float) -> NDArray[np.float32]:
    return sheet.mask([MARKER_CORNERS[:, :2] * [sheet.width * 1.1, high - low] + [0.0, (low + high) / 2]])


def _stripe(sheet: _Sheet, board: Colour, height: float) -> None:
    darker = (board[0] * 0.82, board[1] * 0.82, board[2] * 0.82)
    low = sheet.height * (height - 0.5)
    sheet.print(_band(sheet, low, low + 0.05 * sheet.height), darker, 0.8)


def _tape(sheet: _Sheet, board: Colour) -> None:
    tape = (board[0] * 0.75 + 20, board[1] * 0.8 + 26, board[2] * 0.85 + 26)
    half = 0.09 * sheet.height
    sheet.print(_band(sheet, -half, half), tape, 0.75)
    sheet.print(_band(sheet, -0.6, 0.6), (60.0, 70.0, 80.0), 0.35)


def _seam(sheet: _Sheet, board: Colour) -> None:
    dark = (board[0] * 0.45, board[1] * 0.45, board[2] * 0.45)
    sheet.print(_band(sheet, -1.0, 1.0), dark, 0.8)
