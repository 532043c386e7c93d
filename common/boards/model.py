"""A calibration board: one frozen description from which it is printed, found in pictures and rendered in tests.

Board frame: mm, x right, y down, z into the board (so that a board that faces the camera upright has no rotation), from
the pattern's top left corner: of the first square of a chessboard or ChArUco board (as in OpenCV), of the first tag of
an ArUco grid (as in OpenCV), of the first corner square of an AprilGrid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from common.boards.outlines import outlines
from common.errors import ConfigError
from common.markers import Family, family

Array = NDArray[np.float64]
BoardKind = Literal["chessboard", "charuco", "aprilgrid", "aruco-grid"]
Count = Annotated[int, Field(ge=1, le=200)]
Length = Annotated[float, Field(gt=0, le=10_000, allow_inf_nan=False)]

_SIZES: dict[BoardKind, tuple[str, ...]] = {
    "chessboard": ("square_mm",),
    "charuco": ("square_mm", "marker_mm"),
    "aprilgrid": ("marker_mm", "gap_mm"),
    "aruco-grid": ("marker_mm", "gap_mm"),
}
"""The sizes that describe each kind, all needed."""
_LEAST: dict[BoardKind, int] = {"chessboard": 3, "charuco": 2, "aprilgrid": 1, "aruco-grid": 1}
"""Columns and rows at least: what OpenCV's own search for the kind can handle."""
_UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class BoardPoints:
    """The points to be found on a board: ``ids`` (N,) int64, ascending, and ``mm`` (N, 3) in the board frame."""

    ids: NDArray[np.int64]
    mm: Array


@dataclass(frozen=True, slots=True, eq=False)
class BoardMarker:
    """A marker of a board.

    ``corners``: (4, 2), mm, TL TR BR BL of the marker's *own* frame (see common/markers.py), in the board frame; own TL
    is not always the one at the top left of the board. ``outlines``: its black as closed loops (n, 2), to be filled
    together by the even-odd rule.
    """

    id: int
    corners: Array
    outlines: tuple[Array, ...]


class Board(BaseModel):
    """What a board is. ``columns`` x ``rows`` counts inner corners (chessboard), squares (charuco) or tags (grids).

    ``square_mm``: a square's side; ``marker_mm``: the black square of a marker or tag with its border; ``gap_mm``:
    between two tags of a grid (for an AprilGrid also the side of its corner squares). ``family``: as in the rig file;
    its ids from ``first_id`` on. ``legacy``: ChArUco as OpenCV before 4.6 drew it (differs for even ``rows`` only).
    ``border_bits``: width of a tag's black border in bits (2: boards made by Kalibr). ``measured_scale``: what the
    printed ruler measured, divided by what it should; all points and outlines are multiplied by it.

    ChArUco and ArUco grids are OpenCV's boards: ids by row from the top left, patterns as cv2.aruco draws them, also
    those of its AprilTag dictionaries, which it draws upside down. An AprilGrid is Kalibr's: ids by row from the
    *bottom* left, tags upright in AprilTag's own frame, a black square between each four corners.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: BoardKind
    columns: Count
    rows: Count
    square_mm: Length | None = None
    marker_mm: Length | None = None
    gap_mm: Length | None = None
    family: str | None = None
    first_id: Annotated[int, Field(ge=0)] = 0
    legacy: bool = False
    border_bits: Annotated[int, Field(ge=1, le=2)] = 1
    measured_scale: Annotated[float, Field(gt=0.5, lt=2.0, allow_inf_nan=False)] = 1.0

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        reason = self._fault()
        if reason:
            # A type of its own: whoever reads a file shows these words alone.
            raise PydanticCustomError("unfit", "{reason}", {"reason": reason})
        return self

    def _fault(self) -> str:
        needed = _SIZES[self.kind]
        for key in ("square_mm", "marker_mm", "gap_mm"):
            given = getattr(self, key) is not None
            if given != (key in needed):
                what = f"has no {key}" if given else f"needs {key}"
                return f"a {self.kind} board {what}; its sizes are {' and '.join(needed)}"
        least = _LEAST[self.kind]
        if min(self.columns, self.rows) < least:
            return f"{self.columns} x {self.rows} is too small; a {self.kind} board has at least {least} x {least}"
        if self.legacy and self.kind != "charuco":
            return "legacy is a layout of charuco boards only"
        if self.kind == "chessboard":
            return "a chessboard has no family" if self.family is not None else ""
        if self.family is None:
            return f"family is missing; it says which markers a {self.kind} board carries"
        if self.kind == "charuco" and self._length("marker_mm") >= self._length("square_mm"):
            return f"marker_mm {self.marker_mm:g} must be smaller than square_mm {self.square_mm:g}, which surrounds it"
        return self._family_fault()

    def _family_fault(self) -> str:
        try:
            markers = self.marker_family
        except ConfigError as error:
            return error.message
        last = self.first_id + len(self._places()) - 1
        if last >= markers.ids:
            return f"the board needs the ids {self.first_id} to {last}; {markers.name} has 0 to {markers.ids - 1}"
        return ""

    # --- sizes

    def _length(self, key: str) -> float:
        value = getattr(self, key)
        assert value is not None, f"a {self.kind} board without {key} is refused by its validator"
        return float(value)

    @property
    def marker_family(self) -> Family:
        """The family of the board's markers; a dictionary file's path counts from the working directory."""
        assert self.family is not None, "a chessboard has no markers"
        return family(self.family, Path())

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the black-and-white pattern, without a margin around it, as measured."""
        if self.kind == "chessboard":
            counts, unit, extra = (self.columns + 1, self.rows + 1), self._length("square_mm"), 0.0
        elif self.kind == "charuco":
            counts, unit, extra = (self.columns, self.rows), self._length("square_mm"), 0.0
        else:
            gap = self._length("gap_mm")
            unit = self._length("marker_mm") + gap
            counts, extra = (self.columns, self.rows), gap if self.kind == "aprilgrid" else -gap
        return self.measured_scale * (counts[0] * unit + extra), self.measured_scale * (counts[1] * unit + extra)

    @property
    def ambiguous(self) -> bool:
        """Whether a chessboard looks the same upside down, so that its first corner can't be known."""
        return self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0

    # --- what is found on it

    def points(self) -> BoardPoints:
        """What a search for the board finds.

        Chessboard and ChArUco: the inner corners, by row, ids from 0 (ChArUco: OpenCV's). Grids: four corners a tag,
        id = 4 * tag id + 0 to 3 for TL TR BR BL of the tag's own frame.
        """
        if self.kind in ("aprilgrid", "aruco-grid"):
            ordered = sorted(self.markers, key=lambda marker: marker.id)
            ids = np.array([4 * marker.id + corner for marker in ordered for corner in range(4)])
            flat = np.concatenate([marker.corners for marker in ordered])
        else:
            less = 1 if self.kind == "charuco" else 0
            y, x = np.mgrid[1 : self.rows - less + 1, 1 : self.columns - less + 1]
            flat = np.stack([x.ravel(), y.ravel()], axis=1) * self._length("square_mm") * self.measured_scale
            ids = np.arange(len(flat))
        return BoardPoints(ids.astype(np.int64), np.column_stack([flat, np.zeros(len(flat))]))

    @cached_property
    def markers(self) -> tuple[BoardMarker, ...]:
        """The board's markers in ascending order of their ids; none on a chessboard."""
        if self.kind == "chessboard":
            return ()
        markers, size = self.marker_family, self._length("marker_mm") * self.measured_scale
        # OpenCV's boards show its AprilTag dictionaries upside down: own TL is where the board has bottom right.
        turned = markers.apriltag and self.kind != "aprilgrid"
        order = list(markers.own_order) if turned else [0, 1, 2, 3]
        found = []
        for number, place in enumerate(self._places()):
            bits = np.pad(markers.bitmap(self.first_id + number), self.border_bits - 1) == 0
            shown = np.rot90(bits, 2) if turned else bits
            at = np.asarray(place) * self.measured_scale
            loops = tuple(loop / len(shown) * size + at for loop in outlines(shown))
            found.append(BoardMarker(self.first_id + number, (_UNIT_SQUARE * size + at)[order], loops))
        return tuple(found)

    def _places(self) -> list[tuple[float, float]]:
        """Top left corners of the markers in the order of their ids, mm as drawn (without ``measured_scale``)."""
        across, down = range(self.columns), range(self.rows)
        if self.kind == "charuco":
            square = self._length("square_mm")
            inset = (square - self._length("marker_mm")) / 2
            return [(x * square + inset, y * square + inset) for y in down for x in across if not self._is_black(x, y)]
        gap = self._length("gap_mm")
        unit = self._length("marker_mm") + gap
        if self.kind == "aprilgrid":
            return [(gap + x * unit, gap + y * unit) for y in reversed(down) for x in across]
        return [(x * unit, y * unit) for y in down for x in across]

    def _is_black(self, x: int, y: int) -> bool:
        """Whether a square of a chessboard or ChArUco board is black."""
        old = self.legacy and self.rows % 2 == 0
        return (x + y) % 2 == (1 if old else 0)

    # --- how it looks

    @cached_property
    def squares(self) -> Array:
        """The black squares (N, 4, 2) TL TR BR BL, mm: of the chessboard, or between the tags of an AprilGrid."""
        if self.kind == "aruco-grid":
            return np.zeros((0, 4, 2))
        if self.kind == "aprilgrid":
            gap = self._length("gap_mm")
            unit = self._length("marker_mm") + gap
            corners = [(x * unit, y * unit) for y in range(self.rows + 1) for x in range(self.columns + 1)]
            side = gap
        else:
            side = self._length("square_mm")
            more = 1 if self.kind == "chessboard" else 0
            cells = [(x, y) for y in range(self.rows + more) for x in range(self.columns + more)]
            corners = [(x * side, y * side) for x, y in cells if self._is_black(x, y)]
        return (np.array(corners)[:, None] + _UNIT_SQUARE * side) * self.measured_scale

    def outlines(self) -> tuple[Array, ...]:
        """All that is black as closed loops (n, 2), mm, to be filled together by the even-odd rule on white.

        That is one call of ``cv2.fillPoly`` with all of them; printed and rendered boards both come from here.
        """
        return (*self.squares, *(loop for marker in self.markers for loop in marker.outlines))

    def as_drawn(self) -> Board:
        """The board as it is sent to the printer: ``measured_scale`` 1."""
        return self.with_scale(1.0)

    def with_scale(self, measured_scale: float) -> Board:
        """The same board, printed at another scale. Raises pydantic's ValidationError."""
        return Board.model_validate(self.model_dump() | {"measured_scale": measured_scale})
