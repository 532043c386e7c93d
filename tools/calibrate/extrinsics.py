"""Where cameras stand to each other: from a recorded session, or live from a board that all of them see."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from common.bus import Endpoints, holder_of
from common.calibration.extrinsics import Relative, relative_pose
from common.config import Extrinsics, Rig, load_rig, read_extrinsics, write_extrinsics
from common.errors import EXIT_OK, ConfigError, RefusedError
from common.geometry import CameraModel
from tools.calibrate.board_options import add_board_options, chosen_board
from tools.calibrate.pairs import LivePairs, Seen, from_session

FILE = Path("calibration/extrinsics.yaml")


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which cameras, and where they saw something together."""
    parser.add_argument("--cameras", required=True, metavar="A,B,...", help="the first is the one that others stand to")
    parser.add_argument("--rig", type=Path, default=argparse.SUPPRESS, metavar="FILE", help="the rig file")
    parser.add_argument("--session", type=Path, metavar="DIR", help="a session recorded with --camera all")
    parser.add_argument(
        "--within-ms", type=float, default=10.0, metavar="MS", help="samples taken further apart are left out (10)"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", default=argparse.SUPPRESS, help=f"default: {FILE}")
    add_board_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, write, print."""
    names = [name.strip() for name in args.cameras.split(",") if name.strip()]
    if len(names) < 2 or len(set(names)) < len(names):
        raise ConfigError(f"--cameras must name two or more different cameras, like cam0,cam1, not {args.cameras!r}")
    if args.rig is None:
        raise ConfigError("no rig file: name one with --rig, or go to the folder that has a rig.yaml")
    rig = load_rig(args.rig)
    found: dict[str, tuple[Relative, Seen]] = {}
    for name in names[1:]:
        seen = _seen(args, rig, names[0], name)
        first, second = (_calibrated(label) for label in _labels(seen))
        found[name] = relative_pose(seen.pairs, first, second), seen
    path = args.out or rig.folder / FILE
    known = read_extrinsics(path) if path.is_file() else {}
    known |= {name: _entry(names[0], *one) for name, one in found.items()}
    write_extrinsics(path, known)
    _tell(args, rig, path, names[0], found, known)
    return EXIT_OK


def _seen(args: argparse.Namespace, rig: Rig, first: str, second: str) -> Seen:
    if args.session is not None:
        return from_session(args.session, rig, first, second, args.within_ms)
    board = chosen_board(args)
    endpoints = Endpoints.of(rig.config.network)
    for name in (first, second):
        rig.camera(name)
        if holder_of(endpoints.service_lock(f"capture.{name}")) is None:
            raise RefusedError(
                f"camera {name} doesn't run; start the stack with `tagmill up --rig {rig.path}`, or name a recorded "
                "session with --session",
                code="no_camera",
            )
    live = LivePairs(board, endpoints, first, second)
    console = Console(stderr=True)
    quiet = args.json or not console.is_terminal
    with console.status(f"{first} and {second}") as status:
        if quiet:
            status.stop()
        live.run(lambda words: None if quiet else status.update(f"{first} and {second}: {words}"))
    return live.seen


def _labels(seen: Seen) -> list[Any]:
    if len(seen.cameras) < 2:
        raise RefusedError("no pair of pictures was taken", code="no_views")
    return seen.cameras


def _calibrated(label: Any) -> CameraModel:
    if label.intrinsics_from == "guess":
        raise RefusedError(
            f"camera {label.name} has no calibration; run `tagmill calibrate --camera {label.name}` first",
            code="no_views",
        )
    return CameraModel.from_label(label)


def _entry(to: str, found: Relative, seen: Seen) -> Extrinsics:
    rounded = {
        "rvec": found.pose.rvec.round(7), "tvec_mm": found.pose.translation.round(4),
        "sd_rotation_deg": found.sd_rotation_deg.round(5), "sd_mm": found.sd_mm.round(4),
    }  # fmt: skip
    serials = {label.name: label.serial for label in seen.cameras if label.serial is not None}
    vectors = {key: tuple(float(value) for value in vector) for key, vector in rounded.items()}
    return Extrinsics.model_validate(
        {"to": to, **vectors, "pairs": found.pairs, "rms_px": round(found.rms_px, 4), "serials": serials}
    )


def _tell(
    args: argparse.Namespace,
    rig: Rig,
    path: Path,
    to: str,
    found: dict[str, tuple[Relative, Seen]],
    known: dict[str, Extrinsics],
) -> None:
    named = rig.config.extrinsics is not None and rig.resolve(rig.config.extrinsics) == path.resolve()
    if args.json:
        cameras = {
            name: known[name].model_dump(mode="json") | {"dropped": list(one.dropped), "skipped": seen.skipped}
            for name, (one, seen) in found.items()
        }
        print(json.dumps({"ok": True, "file": str(path), "named_in_rig": named, "cameras": cameras}))
        return
    for name, (one, seen) in found.items():
        at, sd = one.pose.translation, one.sd_mm
        turn = float(np.degrees(np.linalg.norm(one.pose.rvec)))
        place = ", ".join(f"{value:.1f} +- {spread:.2f}" for value, spread in zip(at, sd, strict=True))
        print(f"{name} stands {np.linalg.norm(at):.1f} mm from {to}, at {place} mm (right, down, ahead of {to}),")
        print(
            f"  turned by {turn:.2f} degrees +- {one.sd_rotation_deg.max():.3f}; {one.pairs} pairs, "
            f"rms {one.rms_px:.2f} px"
        )
        for dropped in one.dropped:
            print(f"  left out: {dropped}: contradicts the others (did it move?)")
        for why, count in seen.skipped.items():
            print(f"  left out: {count} {why}")
    print(f"written: {path}")
    if not named:
        inside = path.resolve().is_relative_to(rig.folder)
        shown = path.resolve().relative_to(rig.folder) if inside else path.resolve()
        print(f"to use it, write `extrinsics: {shown}` into {rig.path}")
