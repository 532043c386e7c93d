"""Where views come from: pictures, a video, an earlier run, or a camera that runs."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

from common.boards import Board
from common.calibration import ALL_MODELS, Miss, View
from common.calibration.kept import FOLDER, load_views, places
from common.config import Rig, load_rig
from common.errors import CameraError, ConfigError, RefusedError
from tools.calibrate.board_options import chosen_board
from tools.calibrate.events import Events
from tools.calibrate.feed import Feed
from tools.calibrate.guided_view import GuidedView
from tools.calibrate.live import Session, endpoints_of
from tools.calibrate.pictures import Pictures, frames_of, pictures_of
from tools.calibrate.search import find_views


@dataclass
class Gathered:
    """The board, its views, the pictures without one. ``interrupted``: by Ctrl-C; ``stopped_by``: by what else.

    ``pictures``: where live ones were kept; ``serial``: the camera's, where it told it; ``out``: where files go;
    ``rig``: of a live camera.
    """

    board: Board
    views: list[View]
    misses: list[Miss] = field(default_factory=list)
    interrupted: bool = False
    stopped_by: str = ""
    pictures: Path | None = None
    serial: str | None = None
    out: Path | None = None
    rig: Rig | None = None

    def how_to_use(self, camera: str, file: Path) -> list[str]:
        """What to write into the rig file of a live camera, unless it stands there."""
        if self.rig is None:
            return []
        named = self.rig.camera(camera).calibration
        if named is not None and self.rig.resolve(named) == file.resolve():
            return [f"{self.rig.path} names this file: camera {camera} uses it once its capture process has restarted"]
        path = file.resolve()
        inside = path.is_relative_to(self.rig.folder)
        shown = path.relative_to(self.rig.folder) if inside else path
        where = f"write `calibration: {shown}` at camera {camera} in {self.rig.path}"
        return [f"to use it, {where}, and restart its capture process (`tagmill down`, `tagmill up`)"]


def gather(args: argparse.Namespace, events: Events | None = None) -> Gathered:
    """All views that the arguments ask for; ``events``: to whom a live session is told, instead of the terminal.

    Raises ConfigError, RefusedError, CameraError.
    """
    offline = args.images is not None or args.video is not None
    if args.live and offline:
        raise ConfigError("--live takes views from a running camera; leave --images and --video out")
    if events is not None and (offline or (args.views is not None and not args.live)):
        raise ConfigError("--events is for live views; leave --images and --video out, and give --live with --views")
    board, views = (None, []) if args.views is None else load_views(args.views)
    if args.board is not None or board is None:
        given = chosen_board(args)
        if board is not None and given.points().mm.tolist() != board.points().mm.tolist():
            raise RefusedError(f"the views in {args.views} are of another board", code="no_views")
        board = given
    if not offline and args.views is None and args.camera is None:
        raise ConfigError(
            "where are the pictures? --camera NAME (live), --images DIR, --video FILE, or --views FILE from earlier"
        )
    if args.live or not (offline or args.views is not None):
        return _live(args, board, views, events)
    return _searched(args, Gathered(board, views, out=args.out))


def _searched(args: argparse.Namespace, gathered: Gathered) -> Gathered:
    sources: list[Pictures] = []
    if args.images is not None:
        sources.append(pictures_of(args.images))
    if args.video is not None:
        sources.append(frames_of(args.video))
    for source in sources:
        found = find_views(source, gathered.board, window=args.window, quiet=args.json)
        gathered.views += found.views
        gathered.misses += found.misses
        if found.interrupted:
            gathered.interrupted = True
            break
    return gathered


def _live(args: argparse.Namespace, board: Board, views: list[View], events: Events | None) -> Gathered:
    """Guided, from a camera of the rig; its files go beside the rig, which names them."""
    if args.camera is None:
        raise ConfigError("which camera? --camera NAME, as it is called in the rig file")
    if args.rig is None:
        raise ConfigError("no rig file: name one with --rig, or go to the folder that has a rig.yaml")
    rig = load_rig(args.rig)
    rig.camera(args.camera)
    out = args.out or rig.folder / FOLDER
    session = Session(
        board,
        lambda size: places(out, args.camera, size),
        views=views,
        window=args.window,
        models=[name for name in ALL_MODELS if name in (args.model or ALL_MODELS)],
    )
    taken = session.taken
    try:
        with (
            endpoints_of(rig, args.camera, only_running=events is not None) as (endpoints, process),
            Feed(endpoints, args.camera) as feed,
            GuidedView(args.camera, quiet=args.json) as view,
        ):
            if events is None:
                taken = session.run(feed, view.show, process)
            else:
                taken = session.run(feed, events.show, process, events.orders)
    except CameraError as error:
        if len(taken.views) == len(views):
            raise
        taken.stopped_by = error.message
    return Gathered(
        board, taken.views, interrupted=taken.interrupted, stopped_by=taken.stopped_by, pictures=taken.pictures,
        serial=taken.serial, out=out, rig=rig,
    )  # fmt: skip
