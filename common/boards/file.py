"""Board descriptions as YAML: written beside a printed board, read by `tagmill calibrate`."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import yaml

from common.boards.model import Board
from common.config.problems import Problems
from common.config.schema import read_model
from common.config.tree import Tree, parse_tree, read_tree
from common.errors import ConfigError
from common.markers import is_dictionary_file

WHAT = "board description"


def read_board(path: Path) -> Board:
    """The board that a file describes; a dictionary file's path counts from the description's folder.

    Raises ConfigError with every mistake as ``file:line: field: reason``.
    """
    problems = Problems(path)
    tree = read_tree(path, problems, WHAT)
    if tree is not None:
        _place_dictionary(tree, path.absolute().parent)
    return _board_of(tree, problems, path)


def parse_board(text: str, name: str) -> Board:
    """Like ``read_board``, from the text of a file that is called ``name``."""
    path = Path(name)
    problems = Problems(path)
    return _board_of(parse_tree(text, problems, WHAT), problems, path)


def _board_of(tree: Tree | None, problems: Problems, path: Path) -> Board:
    board = None if tree is None else read_model(tree, problems, Board)
    problems.raise_if_any()
    if board is None:
        raise ConfigError(f"{path}: is no board description")
    return board


def _place_dictionary(tree: Tree, folder: Path) -> None:
    """Make the path of a custom dictionary absolute: the description and its dictionary lie and travel together."""
    named = tree.child("family")
    if named is not None and isinstance(named.value, str) and is_dictionary_file(named.value, folder):
        named.value = str(folder / named.value.strip())


def write_board(path: Path, board: Board) -> None:
    """Write the description, whole or not at all, with the keys that its kind has. Raises ConfigError.

    A dictionary file's path counts from the working directory in ``board``, from ``path``'s folder in the file.
    """
    document = board.model_dump(mode="json", exclude_none=True)
    if board.family is not None and is_dictionary_file(board.family, Path()):
        document["family"] = os.path.relpath(board.family, path.parent)
    if board.kind == "chessboard":
        del document["first_id"], document["border_bits"]
    if board.kind != "charuco":
        del document["legacy"]
    text = "# A calibration board, for `tagmill calibrate`. Sizes in mm as sent to the printer.\n"
    text += "# measured_scale: what the printed 100 mm ruler measures, divided by 100.\n"
    text += yaml.safe_dump(document, sort_keys=False)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # what stood in the way of writing may stand in the way of this
            temporary.unlink(missing_ok=True)
        raise ConfigError(f"{path} can't be written: {error.strerror}; choose another place") from error
