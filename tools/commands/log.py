"""`tagmill log`: how much the services of a running stack log, changed while they run."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import get_args

from common.bus import Endpoints, holder_of
from common.errors import EXIT_OK, RefusedError
from common.log import Level
from common.service.levels import ALL, read_levels, write_level
from tools.commands.client import network_of

_DEFAULT = "default"
_COMMAND = "command"
"""The command socket's lock, which has no socket file beside it where that listens on TCP."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which level, of which service."""
    parser.add_argument(
        "level", nargs="?", choices=(*get_args(Level), _DEFAULT), help="without it: what holds at present"
    )
    parser.add_argument("--service", metavar="ID", default=ALL, help="as `tagmill status` names it (default: all)")


def run(args: argparse.Namespace) -> int:
    """Write the level into the run folder, where every service looks; takes effect within half a second."""
    endpoints = Endpoints.of(network_of(args.rig)[0])
    if args.level is None:
        levels = read_levels(endpoints.run_dir)
    else:
        _refuse_unknown(endpoints, args.service)
        levels = write_level(endpoints.run_dir, args.service, None if args.level == _DEFAULT else args.level)
    if args.json:
        print(json.dumps({"ok": True, "levels": levels}))
    else:
        print("\n".join(f"{name}: {level}" for name, level in levels.items()) or "every service logs at its own level")
    return EXIT_OK


def _refuse_unknown(endpoints: Endpoints, service: str) -> None:
    folder = endpoints.run_dir
    locks = sorted(folder.glob("*.lock")) if folder.is_dir() else []
    running = [lock.stem for lock in locks if not _of_a_socket(lock) and holder_of(lock) is not None]
    if not running:
        raise RefusedError(f"no stack runs in {folder}; start it with 'tagmill up'", code="no_supervisor")
    if service != ALL and service not in running:
        raise RefusedError(f"no service '{service}' runs; there are {', '.join(running)}", code="unknown_service")


def _of_a_socket(lock: Path) -> bool:
    return lock.stem == _COMMAND or lock.with_suffix("").is_socket()
