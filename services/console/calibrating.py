"""What a page asks of a calibration: which boards and kept views there are, begin, take, drop, finish, stop.

Names come from outside, paths don't: a board's file is one of those found beside the rig, a camera one of the rig's.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from common import clock
from common.boards import Board, parse_board, read_board
from common.calibration.kept import FOLDER, Places, board_words, load_views, places
from common.config import Rig
from common.config.problems import Problems
from common.config.tree import parse_tree
from common.errors import ConfigError, RefusedError
from common.ids import NAME_PATTERN
from common.markers import is_predefined, names
from common.messages import CameraState
from services.console.line import Plain

MOST_TEXT = 16_384
_MOST_FILES = 200
_LARGEST_FILE = 65_536


class Start(BaseModel):
    """What shall be calibrated, by which board: one of three ways to name it, or that of the kept views."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    camera: Annotated[str, Field(pattern=NAME_PATTERN)]
    board: dict[str, Any] | None = None
    board_file: Annotated[str | None, Field(max_length=200)] = None
    board_text: Annotated[str | None, Field(max_length=MOST_TEXT)] = None
    go_on: bool = False

    @model_validator(mode="after")
    def _one_board(self) -> Start:
        given = [one for one in (self.board, self.board_file, self.board_text) if one is not None]
        if len(given) != (0 if self.go_on else 1):
            raise ValueError(
                "which board? give one of 'board' (its description), 'board_file' (one beside the rig file) and "
                "'board_text' (a description's YAML); none of them with 'go_on', which has its views' board"
            )
        return self


def boards_beside(rig: Rig) -> dict[str, Board]:
    """The board descriptions beside the rig file and in its calibration folder, by their names from there."""
    found: dict[str, Board] = {}
    for path in _yaml_files(rig.folder):
        try:
            if path.stat().st_size <= _LARGEST_FILE and b"kind" in path.read_bytes():
                found[str(path.relative_to(rig.folder))] = read_board(path)
        except (ConfigError, OSError):  # another file, or gone meanwhile
            continue
    return found


def _yaml_files(folder: Path) -> Iterator[Path]:
    for place in (folder, folder / FOLDER):
        yield from sorted(place.glob("*.yaml"))[:_MOST_FILES]


def kept_places(rig: Rig, camera: str, state: CameraState | None) -> Places | None:
    """Where a camera's calibration goes; None while its picture's size isn't known."""
    if state is None:
        return None
    return places(rig.folder / FOLDER, camera, (state.camera.width, state.camera.height))


def kept(found: Places | None) -> Plain | None:
    """The views that an earlier session left; ``unfinished``: no calibration came of them."""
    if found is None or not found.views.is_file():
        return None
    try:
        board, views = load_views(found.views)
        at_s = found.views.stat().st_mtime
        unfinished = not found.file.is_file() or found.file.stat().st_mtime < at_s
    except (RefusedError, OSError):
        return None
    if not views:
        return None
    at = clock.iso_utc(int(at_s * 1e9))
    return {"views": len(views), "board": board_words(board), "at": at, "unfinished": unfinished}


def arguments(start: Start, rig: Rig, found: Places | None) -> list[str]:
    """The words for `tagmill calibrate`. Raises RefusedError or ConfigError in words for the page."""
    words = ["--rig", str(rig.path)]
    if start.go_on:
        if found is None or kept(found) is None:
            raise RefusedError(f"no views of {start.camera} are kept; begin anew", code="no_views")
        return [*words, "--live", "--views", str(found.views)]
    if start.board_file is not None:
        if start.board_file not in boards_beside(rig):
            raise RefusedError(f"no board description {start.board_file!r} lies beside the rig file", code="no_board")
        return [*words, "--board", str(rig.folder / start.board_file)]
    text = json.dumps(start.board) if start.board_text is None else start.board_text
    return [*words, *_options(_described(text))]


def _described(text: str) -> Board:
    """The board of a description from outside, which may name no file: a family must be a predefined one."""
    name = "the board"
    tree = parse_tree(text, Problems(Path(name)), "board description")
    family = None if tree is None else tree.child("family")
    if family is not None and not (isinstance(family.value, str) and is_predefined(family.value)):
        raise RefusedError(f"{name} has no family of that name; known are {', '.join(names())}", code="bad_request")
    return parse_board(text, name)


def _options(board: Board) -> list[str]:
    given = board.model_dump(exclude_none=True, exclude_defaults=True)
    words = ["--board", given.pop("kind"), "--size", f"{given.pop('columns')}x{given.pop('rows')}"]
    if given.pop("legacy", False):
        words.append("--legacy")
    for key, value in given.items():
        words += [f"--{key.replace('_', '-')}", str(value)]
    return words
