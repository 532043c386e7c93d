"""A calibration board as PDF at true scale, with its description for `tagmill calibrate` beside it.

Without sizes the largest board that the paper holds is made.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from common.boards import Board, read_board, write_board
from common.errors import EXIT_OK, ConfigError, RefusedError
from tools.calibrate.board_options import KINDS, add_description_options, columns_and_rows, given_options, validated
from tools.markers.board_page import BoardPage, describe, draw, fitted
from tools.markers.board_sizes import DEFAULTS, largest, unit_of, with_proportions
from tools.markers.files import pdf_path, png, svg, write_bytes
from tools.markers.measured import is_true, parse_measured
from tools.markers.paper import Paper, parse_paper
from tools.markers.ruler import LENGTH_MM

_PX_PER_MM = 600 / 25.4


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument("board", metavar="KIND|FILE", help=f"{', '.join(KINDS)}, or a description to print again")
    add_description_options(parser.add_argument_group("the board"))
    parser.add_argument("--paper", type=parse_paper, default="A4", help="A4 (default), Letter, A3, ... or 210x297 (mm)")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="the PDF (default: KIND-SIZE.pdf); beside it the .yaml"
    )
    parser.add_argument("--png", action="store_true", help="write the bare board as PNG, too (600 dpi)")
    parser.add_argument("--svg", action="store_true", help="write the bare board as SVG, too")
    parser.add_argument(
        "--measured",
        type=parse_measured,
        metavar="MM",
        help="what the printed 100 mm ruler measures: notes it in the description FILE, nothing is printed",
    )


def run(args: argparse.Namespace) -> int:
    """Write the board, or note in its description how it was printed. Raises RefusedError."""
    try:
        return _run(args)
    except ConfigError as error:
        # A board's mistake is none of the rig file's, which that error's words are about.
        raise RefusedError(error.message, code="bad_board") from error


def _run(args: argparse.Namespace) -> int:
    known = args.board in KINDS
    if args.measured is not None:
        if known:
            raise ConfigError(f"--measured belongs to a board that was printed: name its description, not {args.board}")
        return _note_measured(Path(args.board), args.measured, as_json=args.json)
    paper: Paper = args.paper
    board = _described(args, paper) if known else _read(args)
    page = fitted(board.as_drawn(), paper)
    out: Path = pdf_path(args.out, f"{board.kind}-{board.columns}x{board.rows}.pdf")
    write_bytes(out, draw(page, out.with_suffix(".yaml").name))
    written = [out, *_pictures(page.board, out, as_png=args.png, as_svg=args.svg)]
    description = out.with_suffix(".yaml")
    if known or args.out is not None:
        write_board(description, board)
        written.append(description)
    _tell(args, page, written)
    return EXIT_OK


def _described(args: argparse.Namespace, paper: Paper) -> Board:
    """The board that the options describe; what they leave out is chosen for the paper."""
    default = DEFAULTS[args.board]
    given = {"kind": args.board, **columns_and_rows(args.size or default.size)} | given_options(args)
    if args.board != "chessboard":
        given.setdefault("family", default.family)
    if unit_of(args.board) in given:
        return validated(with_proportions(given))
    return largest(given, paper)


def _read(args: argparse.Namespace) -> Board:
    if args.size is not None or given_options(args):
        raise ConfigError(f"{args.board} describes the board; leave the other options out, or correct the file")
    path = Path(args.board)
    if not path.exists() and path.suffix == "":
        raise ConfigError(f"'{args.board}' is no kind of board and no file; one of {', '.join(KINDS)}")
    return read_board(path)


def _note_measured(path: Path, measured_mm: float, *, as_json: bool) -> int:
    board = read_board(path).with_scale(round(measured_mm / LENGTH_MM, 6))
    write_board(path, board)
    if as_json:
        print(json.dumps({"ok": True, "description": str(path), "board": board.model_dump(exclude_none=True)}))
        return EXIT_OK
    if is_true(measured_mm):
        print(f"The ruler measures {measured_mm:g} mm: true to scale.")
    else:
        print(f"The ruler measures {measured_mm:g} mm instead of {LENGTH_MM}; `tagmill calibrate` will allow for it.")
    print(f"{path}: measured_scale: {board.measured_scale:g}")
    return EXIT_OK


def _pictures(board: Board, out: Path, *, as_png: bool, as_svg: bool) -> list[Path]:
    """The pattern alone with a white margin of a tenth of its width, which detectors need."""
    width, height = board.size_mm
    margin = 0.1 * min(width, height)
    size = (width + 2 * margin, height + 2 * margin)
    loops = [loop + margin for loop in board.outlines()]
    written = []
    for wanted, suffix in ((as_png, ".png"), (as_svg, ".svg")):
        if wanted:
            path = out.with_suffix(suffix)
            write_bytes(path, png(loops, size, _PX_PER_MM) if suffix == ".png" else svg(loops, size, describe(board)))
            written.append(path)
    return written


def _tell(args: argparse.Namespace, page: BoardPage, written: list[Path]) -> None:
    board = page.board
    warnings = []
    if board.ambiguous:
        warnings.append(
            f"{board.columns} x {board.rows} inner corners look the same upside down; one even and one odd number, "
            f"such as {board.columns + 1}x{board.rows}, tell a board's top (needed for `calibrate extrinsics`)"
        )
    if args.json:
        document: dict[str, Any] = {"ok": True, "files": [str(path) for path in written], "paper": page.paper.name}
        print(json.dumps(document | {"board": board.model_dump(exclude_none=True), "warnings": warnings}))
        return
    print(f"{written[0]}: {describe(board)}, on {page.paper.name}")
    for path in written[1:]:
        print(f"  {path}")
    print("".join(f"warning: {text}\n" for text in warnings), end="")
    description = written[-1] if written[-1].suffix == ".yaml" else args.board
    print(f"Print at 100 %, measure the ruler, then: tagmill markers board {description} --measured WHAT-IT-MEASURES")
