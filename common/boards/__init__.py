"""Calibration boards: what one is, where its corners and markers lie, its YAML description."""

from common.boards.file import read_board, write_board
from common.boards.model import Board, BoardKind, BoardMarker, BoardPoints

__all__ = ["Board", "BoardKind", "BoardMarker", "BoardPoints", "read_board", "write_board"]
