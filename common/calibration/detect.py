"""Finds a calibration board in a picture: chessboard, ChArUco (also in part), AprilGrid and ArUco grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.boards import Board
from common.calibration.corners import (
    LEAST_WINDOW,
    MOST_WINDOW,
    USUAL_WINDOW,
    Grey,
    crossings,
    edge_width,
    picture_edge_width,
    saddles,
    spacing,
    window_for,
)
from common.calibration.views import View

Array = NDArray[np.float64]
LEAST_CORNERS = 8
"""Fewer corners than this fix neither a pose nor anything else."""
FRAGILE_PX = 1.0
"""A corner that moves further than this in the usual search window is worth a word."""
BLURRED_PX = 5.0
"""Edges wider than this (10 to 90 %) are blurred."""
_COARSE_PX = 1600
"""A chessboard is first looked for in a picture no wider than this."""


@dataclass(frozen=True)
class Miss:
    """Why a picture gives no view. ``code``: no_board, partial, blurred or wrong_layout."""

    name: str
    code: str
    reason: str


class BoardFinder:
    """Finds one board. ``window``: half the corners' search window, px (None: fitted to each view's squares)."""

    def __init__(self, board: Board, *, window: int | None = None) -> None:
        self.board = board
        self._window = window
        points = board.points()
        self._ids, self._points = points.ids, points.mm

    def find(self, picture: NDArray[np.uint8], name: str) -> View | Miss:
        """The view of a picture (H, W) or (H, W, 3), or why there is none."""
        grey = picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        if self.board.kind == "chessboard":
            found = self._chessboard(grey)
        elif self.board.kind == "charuco":
            found = self._charuco(grey)
        else:
            found = self._grid(grey)
        if found is None or len(found[0]) < LEAST_CORNERS:
            return self._miss(grey, name, 0 if found is None else len(found[0]))
        return self._view(grey, name, *found)

    def _view(self, grey: Grey, name: str, ids: NDArray[np.int64], rough: Array) -> View:
        apart = spacing(rough)
        free = apart * self._free_share
        notes: tuple[str, ...] = ()
        if self.board.kind == "aruco-grid":
            corners = crossings(grey, rough.reshape(-1, 4, 2)).reshape(-1, 2)
        else:
            window = self._window or window_for(apart)
            if self._window is None and free < apart:
                window = int(np.clip(0.7 * free, LEAST_WINDOW, MOST_WINDOW))
            corners = saddles(grey, rough, window)
            if self.board.kind == "chessboard":
                notes = self._fragile(grey, corners, window, apart)
        places = np.searchsorted(self._ids, ids)
        size = (grey.shape[1], grey.shape[0])
        width = edge_width(grey, corners, 0.4 * min(free * 1.2, apart))
        return View(name, size, ids, self._points[places], corners, width, apart, notes)

    def _fragile(self, grey: Grey, corners: Array, window: int, apart: float) -> tuple[str, ...]:
        if window >= USUAL_WINDOW:
            return ()
        moved = float(np.linalg.norm(saddles(grey, corners, USUAL_WINDOW) - corners, axis=1).max())
        if moved < FRAGILE_PX:
            return ()
        words = f"its corners are only {apart:.0f} px apart: the usual search window of {USUAL_WINDOW} px"
        return (f"{words} would move one by {moved:.1f} px; {window} px were used",)

    @cached_property
    def _free_share(self) -> float:
        """How far around a corner nothing else is drawn, as a share of the corners' distance."""
        board = self.board
        if board.kind == "charuco" and board.square_mm and board.marker_mm:
            return (board.square_mm - board.marker_mm) / 2 / board.square_mm
        if board.kind in ("aprilgrid", "aruco-grid") and board.marker_mm and board.gap_mm:
            cells = board.marker_family.cells
            nearest = min(board.marker_mm, board.gap_mm)
            return min(1.0, board.marker_mm / cells / nearest)
        return 1.0

    def _chessboard(self, grey: Grey) -> tuple[NDArray[np.int64], Array] | None:
        size = (self.board.columns, self.board.rows)
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
        scale = min(1.0, _COARSE_PX / max(grey.shape))
        small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        quick = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        found, corners = cv2.findChessboardCorners(small, size, flags=quick)
        if not found:
            found, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
        if not found:
            found, corners = cv2.findChessboardCornersSB(small, size, flags=flags | cv2.CALIB_CB_EXHAUSTIVE)
        if not found:
            return None
        at = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
        return self._ids, at

    def _charuco(self, grey: Grey) -> tuple[NDArray[np.int64], Array] | None:
        corners, found, _, _ = self._charuco_detector.detectBoard(grey)
        ids = _numbers(found)
        if not ids:
            return None
        order = np.argsort(ids)
        return np.array(ids, dtype=np.int64)[order], np.asarray(corners, dtype=np.float64).reshape(-1, 2)[order]

    def _grid(self, grey: Grey) -> tuple[NDArray[np.int64], Array] | None:
        quads, ids, _ = self._marker_detector.detectMarkers(grey)
        order = list(self.board.marker_family.own_order)
        wanted = {marker.id for marker in self.board.markers}
        seen = _numbers(ids)
        # A tag that is read twice is a reflection or a second board; neither can be trusted.
        found = {
            marker: np.asarray(quad, dtype=np.float64).reshape(4, 2)[order]
            for marker, quad in zip(seen, quads, strict=True)
            if marker in wanted and seen.count(marker) == 1
        }
        if not found:
            return None
        tags = sorted(found)
        numbers = np.array([4 * tag + corner for tag in tags for corner in range(4)], dtype=np.int64)
        return numbers, np.concatenate([found[tag] for tag in tags])

    @cached_property
    def _parameters(self) -> cv2.aruco.DetectorParameters:
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = self.board.border_bits
        # Large boards have small markers.
        parameters.minMarkerPerimeterRate = 0.01
        return parameters

    @cached_property
    def _marker_detector(self) -> cv2.aruco.ArucoDetector:
        return cv2.aruco.ArucoDetector(self.board.marker_family.dictionary, self._parameters)

    @cached_property
    def _charuco_detector(self) -> cv2.aruco.CharucoDetector:
        board = self.board
        assert board.square_mm is not None
        assert board.marker_mm is not None
        ids = np.array([marker.id for marker in board.markers], dtype=np.int32)
        layout = cv2.aruco.CharucoBoard(
            (board.columns, board.rows), board.square_mm, board.marker_mm, board.marker_family.dictionary, ids
        )
        layout.setLegacyPattern(board.legacy)
        return cv2.aruco.CharucoDetector(layout, cv2.aruco.CharucoParameters(), self._parameters)

    def _miss(self, grey: Grey, name: str, count: int) -> Miss:
        width = picture_edge_width(grey)
        if count:
            return Miss(name, "partial", f"only {count} corners of the board are seen, {LEAST_CORNERS} are needed")
        if width > BLURRED_PX:
            return Miss(name, "blurred", f"no board found: the picture is blurred (edges {min(width, 99):.0f} px wide)")
        if self.board.kind == "chessboard":
            return Miss(name, "no_board", "no board found: all of a chessboard must be in the picture, lit evenly")
        return self._marker_miss(grey, name)

    def _marker_miss(self, grey: Grey, name: str) -> Miss:
        _, ids, _ = self._marker_detector.detectMarkers(grey)
        seen = set(_numbers(ids))
        own = seen & {marker.id for marker in self.board.markers}
        if len(own) >= 3 and self.board.kind == "charuco":
            return Miss(
                name, "wrong_layout",
                f"{len(own)} of its markers are seen, but they don't lie as they should: are columns, rows and the "
                f"layout ({'legacy' if self.board.legacy else 'new'}) right?",
            )  # fmt: skip
        if seen - own:
            return Miss(name, "no_board", f"markers are seen, but not the board's (ids {_some(seen - own)})")
        return Miss(name, "no_board", f"none of its markers ({self.board.family}) is seen")


def _numbers(ids: Any) -> list[int]:
    """cv2's ids, whose shape differs between its versions; it gives None where there are none."""
    return [] if ids is None else [int(marker) for marker in np.asarray(ids).ravel()]


def _some(ids: set[int]) -> str:
    shown = ", ".join(str(marker) for marker in sorted(ids)[:5])
    return shown + (", ..." if len(ids) > 5 else "")
