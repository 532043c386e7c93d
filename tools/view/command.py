"""Look at a session in Rerun: pictures, depth as points, windows, and the objects' boxes in 3D, over time."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from rich.console import Console
from rich.progress import track

from common.dataset import SessionReader
from common.dataset.boxes import boxes_of
from common.dataset.durable import temporary_path
from common.dataset.faults import explain
from common.errors import EXIT_OK, RefusedError
from tools.dataset.deriving import session_named
from tools.view.recording import Recording, rerun


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session, and where to show it."""
    parser.add_argument("session", metavar="SESSION", help="a session's name below dataset.root, or its folder")
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="write a file for 'rerun FILE.rrd' instead of opening the viewer"
    )
    parser.add_argument("--camera", metavar="CAMERA", help="only of this camera")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only each N-th sample")
    parser.add_argument(
        "--points", type=int, default=4, metavar="N", help="depth as points, one of N each way (0: no points)"
    )
    parser.add_argument("--original", action="store_true", help="the pictures with their markers, where they were kept")


def run(args: argparse.Namespace) -> int:
    """Hand all samples to the viewer, or to a file, which is whole or absent."""
    if args.every < 1 or args.points < 0:
        raise RefusedError("--every counts from 1, --points from 0", code="out_of_bounds")
    module = rerun()
    folder = session_named(args, args.session)
    reader = SessionReader(folder)
    named = ((sample, reader.label(sample)) for sample in reader.samples())
    labels = [label for _, label in named if args.camera in (None, label.camera.name)][:: args.every]
    if not labels:
        raise RefusedError(f"there is no sample to show in {folder.name}", code="no_sample")
    if args.save is None and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RefusedError(
            "there is no screen here for the viewer; --save FILE.rrd writes what 'rerun FILE.rrd' shows elsewhere",
            code="no_screen",
        )
    cameras = tuple(dict.fromkeys(label.camera.name for label in labels))
    recording = Recording(module, folder.resolve().name, boxes_of(reader.session, folder), cameras)
    console = Console(stderr=True)
    target = None if args.save is None else temporary_path(args.save)
    try:
        if target is None:
            recording.show()
        else:
            recording.save(target)
        for label in track(labels, "samples", console=console, disable=not console.is_terminal, transient=True):
            recording.add(reader, label, points=args.points, original=args.original)
        recording.close()
        if target is not None:
            target.replace(args.save)
    except OSError as error:
        told = explain(error, args.save.parent if args.save else folder)
        raise RefusedError(told.message, code="bad_out") from error
    finally:
        if target is not None:
            target.unlink(missing_ok=True)
    if args.json:
        print(json.dumps({"ok": True, "samples": len(labels), "file": None if target is None else str(args.save)}))
    elif target is not None:
        print(
            f"{args.save}: {len(labels)} samples, {args.save.stat().st_size / 1e6:.1f} MB; 'rerun {args.save}' shows it"
        )
    return EXIT_OK
