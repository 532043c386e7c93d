"""Finding the board in all pictures, with a progress bar; Ctrl-C keeps what was found."""

from __future__ import annotations

from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import Progress

from common.boards import Board
from common.calibration import BoardFinder, Miss, View
from tools.calibrate.pictures import Pictures


@dataclass
class Found:
    """Views and misses of all pictures that were looked at; ``interrupted``: by Ctrl-C, before the last one."""

    views: list[View] = field(default_factory=list)
    misses: list[Miss] = field(default_factory=list)
    looked_at: int = 0
    interrupted: bool = False


def find_views(pictures: Pictures, board: Board, *, window: int | None, quiet: bool) -> Found:
    """Look for the board in every picture."""
    finder = BoardFinder(board, window=window)
    found = Found()
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as progress:
        task = progress.add_task("looking for the board", total=len(pictures))
        try:
            for name, picture in pictures.read():
                if picture is None:
                    one: View | Miss = Miss(name, "unreadable", "it can't be read as a picture")
                else:
                    one = finder.find(picture, name)
                (found.misses if isinstance(one, Miss) else found.views).append(one)  # type: ignore[arg-type]
                found.looked_at += 1
                progress.update(task, advance=1, description=f"looking for the board: {len(found.views)} views")
        except KeyboardInterrupt:
            found.interrupted = True
    return found
