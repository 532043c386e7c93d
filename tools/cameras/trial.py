"""One camera alone: its rate, jitter and drops, a picture, how much depth it gives, how it is exposed.

A camera that a running stack holds is looked at through that stack; else its capture process is started here alone,
as in production, on a bus of its own.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from rich.console import Console

from common.bus import Endpoints, holder_of
from common.config import load_rig
from common.errors import EXIT_OK, EXIT_REFUSED, ConfigError
from tools.cameras.alone import alone
from tools.cameras.measure import Measured, measure
from tools.cameras.trial_view import trial_view


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which camera, for how long, where its picture goes."""
    parser.add_argument("name", help="the camera's name in the rig file")
    parser.add_argument("--rig", type=Path, default=argparse.SUPPRESS, metavar="FILE", help="the rig file")
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="how long it is measured (5)")
    parser.add_argument("--wait", type=float, default=20.0, metavar="S", help="how long a first picture may take (20)")
    parser.add_argument("--snapshot", type=Path, metavar="PNG", help="where the picture goes (./camera-NAME.png)")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 3 if no picture came."""
    if not 0 < args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g} must be more than 0 and at most 3600")
    if args.rig is None:
        raise ConfigError("no rig file: name one with --rig, or go to the folder that has a rig.yaml")
    rig = load_rig(args.rig)
    rig.camera(args.name)
    snapshot = args.snapshot or Path(f"camera-{args.name}.png")
    endpoints = Endpoints.of(rig.config.network)
    holder = holder_of(endpoints.service_lock(f"capture.{args.name}"))
    if holder is not None:
        measured = measure(endpoints, rig, args.name, args.seconds, args.wait, snapshot)
    else:
        with alone(rig, args.name, holder="tagmill cameras test") as (own, process):
            measured = measure(own, rig, args.name, args.seconds, args.wait, snapshot, process)
    return _tell(args, measured, holder)


def _tell(args: argparse.Namespace, measured: Measured, holder: str | None) -> int:
    if args.json:
        print(json.dumps({"ok": measured.frames > 0, "held_by": holder} | measured.as_dict()))
    else:
        Console().print(trial_view(measured, holder))
    return EXIT_OK if measured.frames else EXIT_REFUSED
