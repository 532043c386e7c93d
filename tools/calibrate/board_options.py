"""The board, by its description file or by options."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from common.boards import Board, BoardKind, read_board
from common.errors import ConfigError

KINDS: tuple[str, ...] = get_args(BoardKind)
_SIZE = re.compile(r"(\d+)[xX](\d+)")


def add_board_options(parser: argparse.ArgumentParser) -> None:
    """``--board`` and what describes one that has no file."""
    group = parser.add_argument_group("the board")
    group.add_argument("--board", metavar="KIND|FILE", help=f"its YAML description, or one of {', '.join(KINDS)}")
    add_description_options(group)
    group.add_argument(
        "--measured-scale", type=float, metavar="S", help="what the printed ruler measures over what it should"
    )


def add_description_options(group: argparse._ArgumentGroup) -> None:
    """What describes a board of a known kind, here and where it is printed."""
    group.add_argument(
        "--size", metavar="CxR", help="inner corners of a chessboard, squares of a charuco board, tags of a grid"
    )
    group.add_argument("--square-mm", type=float, metavar="MM", help="side of a square (chessboard, charuco)")
    group.add_argument("--marker-mm", type=float, metavar="MM", help="side of a marker's black square")
    group.add_argument("--gap-mm", type=float, metavar="MM", help="between two tags of a grid")
    group.add_argument("--family", metavar="NAME", help="which markers it carries, e.g. 5x5_1000, apriltag_36h11")
    group.add_argument("--first-id", type=int, metavar="N", help="its first marker's id (default 0)")
    group.add_argument("--border-bits", type=int, metavar="N", help="black border of its tags (2: made by Kalibr)")
    group.add_argument("--legacy", action="store_true", default=None, help="charuco: the layout of OpenCV before 4.6")


def chosen_board(args: argparse.Namespace) -> Board:
    """The board that the options describe. Raises ConfigError with every mistake."""
    given = given_options(args)
    if args.measured_scale is not None:
        given["measured_scale"] = args.measured_scale
    if args.board is None:
        raise ConfigError(f"which board? --board FILE (its description), or --board {'|'.join(KINDS)} with --size")
    if args.board not in KINDS:
        board = read_board(Path(args.board))
        if args.size is not None or set(given) - {"measured_scale"}:
            raise ConfigError(f"{args.board} describes the board; leave the other options out, or correct the file")
        return validated(board.model_dump(exclude_none=True) | given)
    return validated({"kind": args.board, **columns_and_rows(args.size), **given})


def given_options(args: argparse.Namespace) -> dict[str, Any]:
    """What of a board's description was given, without kind and size."""
    given = {
        "square_mm": args.square_mm, "marker_mm": args.marker_mm, "gap_mm": args.gap_mm, "family": args.family,
        "first_id": args.first_id, "border_bits": args.border_bits, "legacy": args.legacy,
    }  # fmt: skip
    return {key: value for key, value in given.items() if value is not None}


def columns_and_rows(text: str | None) -> dict[str, int]:
    """From ``9x6``. Raises ConfigError."""
    size = _SIZE.fullmatch(text or "")
    if size is None:
        raise ConfigError(f"--size must be columns x rows, like 9x6, not {text!r}")
    return {"columns": int(size[1]), "rows": int(size[2])}


def validated(described: Mapping[str, Any]) -> Board:
    """The board. Raises ConfigError that names the options."""
    try:
        return Board.model_validate(described)
    except ValidationError as error:
        problems = tuple(
            f"--{'-'.join(str(part) for part in item['loc']).replace('_', '-') or 'board'}: {item['msg']}"
            for item in error.errors(include_url=False)
        )
        raise ConfigError(f"the board can't be as described: {'; '.join(problems)}", problems) from error
