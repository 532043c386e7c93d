"""Calibration boards: what one is, where its corners and markers lie, its YAML description."""

from common.boards.file import parse_board, read_board, write_board
from common.boards.model import Board, BoardKind, BoardMarker, BoardPoints
from common.boards.stand import outline, standing

__all__ = [
    "Board",
    "BoardKind",
    "BoardMarker",
    "BoardPoints",
    "outline",
    "parse_board",
    "read_board",
    "standing",
    "write_board",
]
