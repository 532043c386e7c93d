"""The command line that all services share."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NoReturn

from common.errors import ConfigError

NAME_WAIT_S = 30.0

TOLD_APART_BY: dict[str, Literal["camera", "instance"]] = {
    "capture": "camera",
    "detect": "instance",
    "label": "instance",
}
"""How the processes of one service differ; services not named here run once a stack."""


class _Parser(argparse.ArgumentParser):
    """A mistake on the command line is a mistake of the configuration: it stands in the supervisor's file."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"command line: {message} (see --help)")


def parse(name: str, argv: Sequence[str] | None) -> argparse.Namespace:
    """The arguments of service ``name``; raises ConfigError for what doesn't fit."""
    parser = _Parser(prog=f"python -m services.{name}", description=f"tagmill's {name} service")
    parser.add_argument("--rig", type=Path, required=True, help="the rig file")
    parser.add_argument("--camera", help="the camera's name in the rig file")
    parser.add_argument("--camera-file", type=Path, help="a file with further cameras, for this process only")
    parser.add_argument("--instance", type=int, default=0, help="which of several processes (0, 1, ...)")
    parser.add_argument("--new-session", action="store_true", help="where the rig differs, begin a new session")
    parser.add_argument(
        "--name-wait-s", type=float, default=NAME_WAIT_S, help="how long a taken name is waited for (30)"
    )
    parser.add_argument("--log-level", choices=("debug", "info", "warning", "error"), default="info")
    args = parser.parse_args(argv)
    if not 0 <= args.instance < 100:
        raise ConfigError(f"command line: --instance {args.instance} must be 0 to 99")
    return args


def service_id(name: str, args: argparse.Namespace) -> str:
    """``capture.cam0``, ``label.0``, ``store``; raises ConfigError if the camera isn't named."""
    told_apart_by = TOLD_APART_BY.get(name)
    if told_apart_by == "instance":
        return f"{name}.{args.instance}"
    if told_apart_by is None:
        return name
    if not args.camera:
        raise ConfigError(f"command line: {name} serves one camera; name it with --camera")
    return f"{name}.{args.camera}"
