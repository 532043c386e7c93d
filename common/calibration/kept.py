"""Where a calibration's files lie beside the rig, and the views that are kept so that one can go on with them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from common.boards import Board
from common.bounded import parse_json, read_bytes
from common.calibration.views import View, view_from
from common.config.whole_file import write_whole
from common.errors import ConfigError, RefusedError

FOLDER = "calibration"
"""Beside the rig file."""
MOST_VIEWS_BYTES = 64 << 20
"""Of a file of kept views; a hundred views of a large board are 2 MiB."""


@dataclass(frozen=True)
class Places:
    """Where the files of one calibration go: ``file`` the calibration, beside it report and views."""

    file: Path

    @property
    def report(self) -> Path:
        """The page with tables and plots."""
        return self.file.with_suffix(".html")

    @property
    def views(self) -> Path:
        """The corners that were found."""
        return self.file.with_suffix(".views.json")

    @property
    def pictures(self) -> Path:
        """The folder of live pictures that gave views."""
        return self.file.with_name(f"{self.file.stem}-views")

    @property
    def previous(self) -> Path:
        """Where a calibration that is replaced goes."""
        return self.file.with_suffix(".previous.yaml")


def places(out: Path | None, camera: str, size: tuple[int, int] | None) -> Places:
    """``out`` names a file (.yaml), a folder, or nothing: then ``calibration/<camera>-<width>x<height>.yaml``."""
    if out is not None and out.suffix.lower() in (".yaml", ".yml"):
        return Places(out)
    name = camera if size is None else f"{camera}-{size[0]}x{size[1]}"
    # A name with dots would lose its end to with_suffix.
    return Places((out or Path(FOLDER)) / f"{name.replace('.', '_')}.yaml")


def board_words(board: Board) -> str:
    """A board in a few words."""
    sizes = {"square": board.square_mm, "marker": board.marker_mm, "gap": board.gap_mm}
    given = ", ".join(f"{name} {value:g} mm" for name, value in sizes.items() if value is not None)
    scale = "" if board.measured_scale == 1.0 else f", measured scale {board.measured_scale:g}"
    return f"{board.kind} {board.columns}x{board.rows}, {given}{scale}"


def save_views(path: Path, board: Board, views: Sequence[View]) -> None:
    """Write the views for another run. Raises RefusedError where that can't be done."""
    document = {"board": board.model_dump(mode="json"), "views": [view.document() for view in views]}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(document) + "\n", "choose another place with --out")
    except ConfigError as error:
        raise RefusedError(error.message) from error
    except OSError as error:
        raise RefusedError(f"{path} can't be written: {error.strerror}; choose another place with --out") from error


def load_views(path: Path) -> tuple[Board, list[View]]:
    """Board and views of a file that ``save_views`` wrote. Raises RefusedError."""
    try:
        document = parse_json(read_bytes(path, MOST_VIEWS_BYTES))
        return Board.model_validate(document["board"]), [view_from(one) for one in document["views"]]
    except OSError as error:
        raise RefusedError(f"{path} can't be read: {error.strerror}", code="no_views") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RefusedError(f"{path} holds no views of tagmill calibrate: {error}", code="no_views") from error
