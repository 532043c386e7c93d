"""Taking views from a camera that runs: each frame to the guide, what it says to the screen, what it takes to disk."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from common.boards import Board
from common.bus import Endpoints, holder_of
from common.calibration import ALL_MODELS, BoardFinder, Guidance, Guide, Outcome, View, calibrate
from common.calibration.kept import Places, save_views
from common.config import Rig
from common.errors import RefusedError
from common.messages import FrameRef
from tools.calibrate.feed import Colour, Feed
from tools.cameras.alone import alone

STEP_S = 0.1
QUICK: tuple[str, ...] = ("5",)
"""The lens model by which it is judged whether the views will do; only then all are compared."""
LEAST_NS = 60_000_000
"""No more frames than this are looked at: stillness needs few, and the machine has other work."""
Show = Callable[[Guidance], None]
Orders = Callable[[], Sequence[str]]
"""What the operator asked for since it was called last: take, drop, finish, end."""


@dataclass
class Taken:
    """What a session left: all views, where pictures lie; why it ended before the guide was done, if it did."""

    views: list[View]
    pictures: Path | None = None
    serial: str | None = None
    interrupted: bool = False
    stopped_by: str = ""


@contextmanager
def endpoints_of(
    rig: Rig, name: str, *, only_running: bool = False
) -> Iterator[tuple[Endpoints, subprocess.Popen[bytes] | None]]:
    """Where the camera is heard: in the running stack, or alone in its capture process, started here.

    Raises RefusedError for a camera that doesn't run, if ``only_running``.
    """
    running = Endpoints.of(rig.config.network)
    if holder_of(running.service_lock(f"capture.{name}")) is not None:
        yield running, None
        return
    if only_running:
        raise RefusedError(f"the capture process of camera {name} doesn't run; see its log", code="no_camera")
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

    def run(
        self, feed: Feed, show: Show, process: subprocess.Popen[bytes] | None = None, orders: Orders = tuple
    ) -> Taken:
        """Take views until the guide is done, Ctrl-C, or the camera is gone; what was taken is kept in any case.

        Raises RefusedError where there was no picture at all.
        """
        taken = self.taken
        last: FrameRef | None = None
        try:
            while self._guide is None or not self._guide.done:
                feed.listen(STEP_S)
                if self._obeyed(orders(), show):
                    break
                ref = feed.newest()
                if ref is not None and _is_due(ref, last):
                    last = ref
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

    def _obeyed(self, orders: Sequence[str], show: Show) -> bool:
        """Carry orders out; True if the session shall be finished with what there is."""
        for order in orders:
            if order == "end":
                raise KeyboardInterrupt
            if order == "finish":
                return True
            if self._guide is None:
                continue
            if order == "take":
                self._guide.demand()
            elif order == "drop":
                self._drop(self._guide, show)
        return False

    def _drop(self, guide: Guide, show: Show) -> None:
        """The newest view, also on the disk; a picture of an earlier session stays."""
        gone = guide.views[-1:]
        show(guide.drop_last())
        for view in gone:
            if self.taken.pictures is not None:
                (self.taken.pictures / view.name).unlink(missing_ok=True)
            self.taken.views = list(guide.views)
            assert self._found is not None
            save_views(self._found.views, self._board, guide.views)

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
            show(replace(told, words="working out how good the calibration is", code="judging", taken=None))
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


def _is_due(ref: FrameRef, last: FrameRef | None) -> bool:
    return last is None or ref.boot != last.boot or ref.captured_mono_ns - last.captured_mono_ns >= LEAST_NS


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
