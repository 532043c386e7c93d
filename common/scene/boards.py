"""A calibration board in the scene: printed on white card, held still at one pose after another, all of it in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.boards import Board, standing
from common.geometry import CameraModel, Pose
from common.scene.light import Light
from common.scene.raster import BLACK, WHITE, Patch, draw_texture
from common.scene.rays import PixelRays, Region
from common.scene.seeds import generator
from common.scene.seen import Rectangle, Seen, look_at
from common.scene.texture import Texture

Array = NDArray[np.float64]
BOARD = "calibration board"
"""Its name among the scene's drawings."""
_FINEST_PER_MM, _MOST_TEXELS = 10, 4000
_CARD_SHARE = 0.06
"""The white card around the pattern, as a share of its longer side."""
HOLD_FRAMES, MOVE_FRAMES = 45.0, 30.0
"""At speed 1 and 30 frames/s the board is held for 1.5 s, and takes 1 s to its next pose."""
_PLACES = tuple((x, y) for y in (0.17, 0.5, 0.83) for x in (0.17, 0.5, 0.83))
_TILTS = ((35.0, 0.0), (35.0, 90.0), (35.0, 180.0), (35.0, 270.0), (0.0, 0.0))
"""Tilt and its direction, degrees, one after the other; there are as many pairs with the places as there can be."""
_NEAR, _FAR = 0.62, 0.36
"""How much of the picture the board takes up at its nearest and farthest."""
_ROOM = 2.0
"""So much farther than the board at its farthest is the middle of the room: tilted ones stand back a little."""


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """A board before a camera: the pixels that it can touch, and how it is seen."""

    region: Region
    card: Seen


class BoardDrawing:
    """Draws one board; a scene's drawing as ``objects.BoxDrawing`` is."""

    def __init__(self, board: Board) -> None:
        self._card = float(round(_CARD_SHARE * max(board.size_mm)))
        self._size = board.size_mm
        width, height = (side + 2 * self._card for side in board.size_mm)
        self._texture = Texture(_printed(board, self._card), width, height)

    def see(self, rays: PixelRays, pose: Pose) -> SeenBoard | None:
        """How a camera sees the board; ``pose``: board frame (y down, z into it) to camera frame."""
        middle = np.array([*self._size, 0.0]) / 2
        centred = Pose(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.apply(middle)[0])
        found = look_at(rays, [Rectangle(centred, self._texture.width_mm, self._texture.height_mm)])[0]
        return None if found is None else SeenBoard(found.region, found)

    def draw(self, patch: Patch, rays: PixelRays, seen: SeenBoard, to_scene: Pose, light: Light, index: float) -> None:
        """Draw the board into a patch; ``to_scene``: camera to scene frame, in which the lamp moves."""
        shade = light.shade(to_scene.rotation @ seen.card.shape.pose.rotation[:, 2], index)
        draw_texture(patch, rays, seen.card, self._texture, shade)


class BoardPath:
    """Where the board is held. ``frustum``: tangents of half the field of view in which it stays; seeded, endless."""

    def __init__(self, board: Board, frustum: tuple[float, float], seed: int, speed: float) -> None:
        self._size = board.size_mm
        self._seed = seed
        self._speed = speed
        width, height = 1000.0 * frustum[0], 1000.0 * frustum[1]
        matrix = np.array([[500.0, 0, (width - 1) / 2], [0, 500.0, (height - 1) / 2], [0, 0, 1]])
        self._camera = CameraModel(round(width), round(height), matrix, np.zeros(5))

    @staticmethod
    def room_mm(board: Board, frustum: tuple[float, float]) -> float:
        """How large the room must be (its ``distance_mm``) so that the board is always before its wall."""
        return _ROOM * max(side / (2 * half * _FAR) for side, half in zip(board.size_mm, frustum, strict=True))

    def pose(self, index: float) -> Pose:
        """Board frame to scene frame at a frame number (30 to the second, fractions allowed)."""
        number, frames = divmod(index * self._speed, HOLD_FRAMES + MOVE_FRAMES)
        here = self._stop(int(number))
        if frames <= HOLD_FRAMES:
            return here
        share = (frames - HOLD_FRAMES) / MOVE_FRAMES
        return _between(here, self._stop(int(number) + 1), share * share * (3 - 2 * share), self._size)

    def _stop(self, number: int) -> Pose:
        """Each place comes up once in nine stops, each tilt once in five."""
        lap, at = divmod(number, len(_PLACES))
        order = generator(self._seed, "board", lap).permutation(len(_PLACES))
        tilt, towards = _TILTS[number % len(_TILTS)]
        draws = generator(self._seed, "stop", number).uniform(0, 1, 3)
        return standing(
            self._size,
            self._camera,
            place=_PLACES[order[at]],
            tilt_deg=tilt + 8 * draws[0] * (tilt > 0),
            towards_deg=towards + 30 * (draws[1] - 0.5),
            share=_FAR + (_NEAR - _FAR) * draws[2],
        )


def _between(start: Pose, end: Pose, share: float, size_mm: tuple[float, float]) -> Pose:
    """The middle on a straight line, the turn by the shortest way."""
    middle = np.array([*size_mm, 0.0]) / 2
    turn = Pose(end.rotation @ start.rotation.T, np.zeros(3))
    rotation = Pose.from_rvec(share * turn.rvec, np.zeros(3)).rotation @ start.rotation
    at = (1 - share) * start.apply(middle)[0] + share * end.apply(middle)[0]
    return Pose(rotation, at - rotation @ middle)


def _printed(board: Board, card_mm: float) -> NDArray[np.uint8]:
    """The board on its card, BGR, edges at whole texels: as exact as the texels are fine.

    All of a board's outlines run along its axes, so that a row of texels is black between every second crossing of an
    upright edge.
    """
    width, height = board.size_mm
    per_mm = max(1, min(_FINEST_PER_MM, int(_MOST_TEXELS / (max(width, height) + 2 * card_mm))))
    columns, rows = (round((side + 2 * card_mm) * per_mm) for side in (width, height))
    crossings = np.zeros((rows, columns + 1), dtype=np.uint8)
    for loop in board.outlines():
        at = np.rint((loop + card_mm) * per_mm).astype(int)
        for (x, y), (other, end) in zip(at, np.roll(at, -1, axis=0), strict=True):
            if x == other:
                crossings[min(y, end) : max(y, end), x] ^= 1
    black = np.bitwise_xor.accumulate(crossings, axis=1)[:, :columns]
    grey = np.where(black == 1, BLACK, WHITE).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
