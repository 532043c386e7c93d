"""`tagmill calibrate`: intrinsics from a live camera, pictures or a video of a board, with a verdict and a report."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from common.calibration import ALL_MODELS, Miss, Outcome, Reason, View, calibrate
from common.calibration.candidates import steps
from common.calibration.kept import Places, places, save_views
from common.calibration.verdict import verdict
from common.config import read_calibration, write_calibration
from common.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_REFUSED, ConfigError, RefusedError
from tools.calibrate import convert, extrinsics
from tools.calibrate.board_options import add_board_options
from tools.calibrate.events import Events
from tools.calibrate.gather import Gathered, gather
from tools.calibrate.measured import HONEST, judge_measured, parse_measured
from tools.calibrate.report import write_report
from tools.calibrate.result import document, label_of, quality_of
from tools.calibrate.words import said


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    source = parser.add_argument_group("where the pictures come from (none of these: live, from --camera)")
    source.add_argument("--images", metavar="DIR|GLOB", help="a folder of pictures, or a quoted pattern")
    source.add_argument("--video", type=Path, metavar="FILE", help="a video; at most 300 frames of it are looked at")
    source.add_argument("--views", type=Path, metavar="FILE", help="go on with the views that an earlier run kept")
    source.add_argument("--live", action="store_true", help="go on live with the views that --views names")
    source.add_argument(
        "--events", action="store_true",
        help="live, for a program that shows it: what happens as JSON lines, orders (take, drop, finish) on stdin",
    )  # fmt: skip
    add_board_options(parser)
    parser.add_argument("--camera", metavar="NAME", help="the camera's name in the rig; needed for live views")
    parser.add_argument("--serial", metavar="S", help="the camera's serial number: the file then fits no other")
    parser.add_argument(
        "--model", choices=ALL_MODELS, action="append", help="only this lens model (default: the best; may be repeated)"
    )
    parser.add_argument("--window", type=int, metavar="PX", help="half the corners' search window (default: fitted)")
    parser.add_argument("--distance-mm", type=float, metavar="MM", help="working distance for the uncertainty map")
    parser.add_argument("--measured", metavar="NAME=MM", help="a distance measured from camera to board in one view")
    parser.add_argument("--out", type=Path, metavar="FILE|DIR", help="default: calibration/<camera>-<size>.yaml")
    parser.add_argument("--anyway", action="store_true", help="write the file even if the verdict is 'not yet'")
    more = parser.add_subparsers(dest="calibrate_command", metavar="convert|extrinsics", title="more")
    own = more.add_parser("convert", help="write a calibration in another format", description=convert.__doc__)
    own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
    convert.add_parser(own)
    own = more.add_parser("extrinsics", help="where cameras stand to each other", description=extrinsics.__doc__)
    own.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document")
    extrinsics.add_parser(own)


def run(args: argparse.Namespace) -> int:
    """Calibrate; exit code 0 with a calibration, 3 if the verdict is 'not yet', 130 after Ctrl-C."""
    if args.calibrate_command == "convert":
        return convert.run(args)
    if args.calibrate_command == "extrinsics":
        return extrinsics.run(args)
    measured = None if args.measured is None else parse_measured(args.measured)
    _check_figures(args)
    events = Events() if args.events else None
    args.json = args.json or args.events
    found, got = _gathered(args, events)
    if got.interrupted:
        return _interrupted(found, got, quiet=args.json)
    try:
        outcome = _calibrated(args, got.views, got.misses, events)
    except KeyboardInterrupt:
        return _interrupted(found, got, quiet=args.json)
    told = [f"the camera stopped: {got.stopped_by}"] if got.stopped_by else []
    if measured is not None and outcome.solution is not None:
        words, reasons = judge_measured(outcome.solution, *measured)
        told.append(words)
        outcome = replace(outcome, verdict=verdict(outcome.verdict.reasons, reasons))
    if measured is None and outcome.solution is not None:
        told.append(HONEST)
    return _finish(args, got, outcome, found, told)


def _check_figures(args: argparse.Namespace) -> None:
    for name, least in (("distance_mm", 1.0), ("window", 1)):
        value = getattr(args, name)
        if value is not None and not value >= least:
            raise RefusedError(
                f"--{name.replace('_', '-')} must be at least {least:g}, not {value}", code="bad_request"
            )


def _gathered(args: argparse.Namespace, events: Events | None) -> tuple[Places, Gathered]:
    """The views, which are kept first of all."""
    got = gather(args, events)
    args.camera = args.camera or "camera"
    args.serial = args.serial or got.serial
    found = places(got.out, args.camera, _most_common_size(got.views))
    if got.views or not got.interrupted:
        save_views(found.views, got.board, got.views)
    return found, got


def _calibrated(
    args: argparse.Namespace, views: Sequence[View], misses: Sequence[Miss], events: Events | None
) -> Outcome:
    models = tuple(args.model or ALL_MODELS)
    console = Console(stderr=True)
    total = steps(models)
    with Progress(console=console, transient=True, disable=args.json or not console.is_terminal) as progress:
        task = progress.add_task("comparing lens models", total=total)

        def tick() -> None:
            progress.advance(task)
            if events is not None:
                events.progress(int(progress.tasks[0].completed), total)

        return calibrate(
            views,
            models=[name for name in ALL_MODELS if name in models],
            distance_mm=args.distance_mm,
            extra=missed_reasons(views, misses),
            tick=tick,
        )


def missed_reasons(views: Sequence[View], misses: Sequence[Miss]) -> list[Reason]:
    """What the pictures without a board say of the whole set."""
    if not misses or len(misses) < max(2 * len(views), 1):
        return []
    code, count = Counter(miss.code for miss in misses).most_common(1)[0]
    reason = next(miss.reason for miss in misses if miss.code == code)
    total = len(views) + len(misses)
    return [Reason(code, "not yet", f"{count} of {total} pictures give no view ({reason})")]


def _most_common_size(views: Sequence[View]) -> tuple[int, int] | None:
    sizes = Counter(view.size for view in views).most_common(1)
    return sizes[0][0] if sizes else None


def _interrupted(found: Places, got: Gathered, *, quiet: bool) -> int:
    pictures = None if got.pictures is None else str(got.pictures)
    if quiet:
        kept = {"views": str(found.views), "pictures": pictures}
        print(json.dumps({"ok": False, "error": {"code": "interrupted"}} | kept))
        return EXIT_INTERRUPTED
    if not got.views:
        print("Interrupted. No view was taken yet.")
        return EXIT_INTERRUPTED
    print(f"Interrupted. {len(got.views)} views are kept in {found.views}; go on with --views {found.views}")
    if pictures is not None:
        print(f"(live: --live --views {found.views}). This session's pictures are in {pictures}, for --images")
    return EXIT_INTERRUPTED


def _finish(args: argparse.Namespace, got: Gathered, outcome: Outcome, found: Places, told: list[str]) -> int:
    board, misses = got.board, got.misses
    solution = outcome.solution
    write_report(found.report, args.camera, board, outcome, misses, told)
    good = outcome.verdict.level != "not yet"
    written = solution is not None and (good or args.anyway)
    if solution is not None and written:
        told += _replaced(found)
        quality = quality_of(outcome, solution, board).model_dump(mode="json")
        write_calibration(found.file, label_of(solution, args.camera, args.serial), quality)
        told += got.how_to_use(args.camera, found.file)
    if args.json:
        out = document(outcome, board, misses, found) | {"file": str(found.file) if written else None, "notes": told}
        out |= {"serial": args.serial, "pictures": None if got.pictures is None else str(got.pictures)}
        print(json.dumps(out))
    else:
        print("\n".join(said(outcome, misses, told)))
        if written:
            print(f"written: {found.file}")
        elif solution is not None:
            print(f"not written: {found.file} (--anyway writes it)")
        print(f"report:  {found.report}")
        if got.pictures is not None:
            print(f"views:   {got.pictures} (pictures), {found.views} (corners)")
    return EXIT_OK if good else EXIT_REFUSED


def _replaced(found: Places) -> list[str]:
    """Set an older calibration of this name aside, and say so."""
    if not found.file.is_file():
        return []
    try:
        read_calibration(found.file, "before")
        found.file.replace(found.previous)
    except (ConfigError, OSError) as error:
        raise RefusedError(f"{found.file} is in the way: {error}; choose another place with --out") from error
    return [f"the calibration that was there is now {found.previous}"]
