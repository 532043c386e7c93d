"""Make one session of several that were recorded with the same rig; they stay as they are (pictures are linked)."""

from __future__ import annotations

import argparse

from common.dataset.derive import Taken
from common.dataset.snapshot import Snapshot
from common.errors import RefusedError
from tools.dataset.deriving import add_rig, beside, make, session_named, tell


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which sessions, and what the new one is called."""
    add_rig(parser)
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="a session's name below dataset.root, or folder")
    parser.add_argument("--into", required=True, metavar="NAME", help="the new session's name, beside the first one")


def run(args: argparse.Namespace) -> int:
    """All samples of all sessions."""
    folders = [session_named(args, name) for name in args.sessions]
    if len({folder.resolve() for folder in folders}) < max(len(folders), 2):
        raise RefusedError("name two sessions or more, each once", code="refused")
    target = beside(folders[0], args.into)
    return tell(args, [(target, make(target, [Taken(Snapshot(folder)) for folder in folders]))])
