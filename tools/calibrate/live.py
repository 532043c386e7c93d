"""Taking views from a camera that runs: each frame to the guide, what it says to the screen, what it takes to disk."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2

from common.boards import Board
from common.bus import Endpoints, holder_of
from common.calibration import ALL_MODELS, BoardFinder, Guidance, Guide, Outcome, View, calibrate
from common.config import Rig
from common.errors import RefusedError
from common.messages import FrameRef
from tools.calibrate.feed import Colour, Feed
from tools.calibrate.result import Places, save_views
from tools.cameras.alone import alone

STEP_S = 0.1
QUICK: tuple[str, ...] = ("5",)
"""The lens model by which it is judged whether the views will do; only then all are compared."""
Show = Callable[[Guidance], None]


@dataclass
class Taken:
    """What a session left: all views, where pictures lie; why it ended before the guide was done, if it did."""

    views: list[View]
    pictures: Path | None = None
    serial: str | None = None
    interrupted: bool = False
    stopped_by: str = ""


@contextmanager
def endpoints_of(rig: Rig, name: str) -> Iterator[tuple[Endpoints, subprocess.Popen[bytes] | None]]:
    """Where the camera is heard: in the running stack, or alone in its capture process, started here."""
    running = Endpoints.of(rig.config.network)
    if holder_of(running.service_lock(f"capture.{name}")) is not None:
        yield running, None
        return
    with alone(rig, name, holder="tagmill calibrate") as (own, process):
        yield own, process


class Session:
    """One guided session. ``places``: where its files go, by the picture's size; ``views`` of an earlier one."""

    def __init__(
        self,
        board: Board,
        places: Callable[[tuple[int, int]], Places],
        *,
        views: Sequence[View] = (),
        window: int | None = None,
        models: Sequence[str] = ALL_MODELS,
    ) -> None:
        self._board = board
        self._places = places
        self._earlier = list(views)
        self._finder = BoardFinder(board, window=window)
        self._models = tuple(models)
        self._found: Places | None = None
        self._guide: Guide | None = None
        self.taken = Taken(list(views))

    def run(self, feed: Feed, show: Show, process: subprocess.Popen[bytes] | None = None) -> Taken:
        """Take views until the guide is done, Ctrl-C, or the camera is gone; what was taken is kept in any case.

        Raises RefusedError where there was no picture at all.
        """
        taken, last = self.taken, None
        try:
            while self._guide is None or not self._guide.done:
                feed.listen(STEP_S)
                ref = feed.newest()
                if ref is not None and (ref.boot, ref.frame) != last:
                    last = (ref.boot, ref.frame)
                    self._look(feed, ref, show)
                elif process is not None and process.poll() is not None:
                    break  # whoever started it says why it ended
        except KeyboardInterrupt:
            taken.interrupted = True
        except RefusedError as error:
            if self._guide is None or len(self._guide.views) == len(self._earlier):
                raise
            taken.stopped_by = error.message
        if feed.state is not None:
            taken.serial = feed.state.camera.serial
        return taken

    def _look(self, feed: Feed, ref: FrameRef, show: Show) -> None:
        picture = feed.read(ref)
        if picture is None:
            return
        guide = self._guide_for((picture.shape[1], picture.shape[0]))
        told = guide.look(self._finder.find(picture, ref.source_name or f"frame {ref.frame}"), ref.captured_mono_ns)
        if told.taken is not None:
            self._keep(guide, told.taken, picture)
        show(told)
        if guide.wants_verdict:
            show(guide.judge(self._judged(guide)))

    def _guide_for(self, size: tuple[int, int]) -> Guide:
        if self._guide is None:
            other = next((view.size for view in self._earlier if view.size != size), None)
            if other is not None:
                was, now = ("x".join(map(str, item)) for item in (other, size))
                raise RefusedError(f"the kept views are of {was} pictures, the camera gives {now}", code="no_views")
            self._found = self._places(size)
            self._guide = Guide(self._board, size, self._earlier)
        return self._guide

    def _judged(self, guide: Guide) -> Outcome:
        quick = QUICK if set(QUICK) < set(self._models) else self._models
        outcome = calibrate(guide.views, models=quick)
        if outcome.verdict.level != "good" or quick == self._models:
            return outcome
        return calibrate(guide.views, models=self._models)

    def _keep(self, guide: Guide, view: View, picture: Colour) -> None:
        assert self._found is not None
        if self.taken.pictures is None:
            self.taken.pictures = free_folder(self._found.pictures)
        self.taken.views = list(guide.views)
        path = self.taken.pictures / view.name
        if not cv2.imwrite(str(path), picture):
            raise RefusedError(f"{path} can't be written; is the disk full? choose another place with --out")
        save_views(self._found.views, self._board, guide.views)


def free_folder(wanted: Path) -> Path:
    """Make the folder, or where one of that name holds something, the next: pictures of two sessions never mix."""
    folder, number = wanted, 1
    try:
        while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            number += 1
            folder = wanted.with_name(f"{wanted.name}-{number}")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RefusedError(f"{folder} can't be made: {error.strerror}; choose another place with --out") from error
    return folder
