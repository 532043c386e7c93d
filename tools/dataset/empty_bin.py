"""Remove the samples in a session's bin for good (--yes); nothing brings them back.

Not while a stack has the session open.
"""

from __future__ import annotations

import argparse
import json

from common.dataset.bin import bin_of, labelled
from common.dataset.emptied import empty
from common.dataset.head import recording_of
from common.errors import EXIT_OK, RefusedError
from tools.dataset.place import InFolder, add_place, chosen

_MB = 1e6


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session, and whether it is meant."""
    add_place(parser)
    parser.add_argument("--yes", action="store_true", help="really remove them; without it only their number is told")


def run(args: argparse.Namespace) -> int:
    """Print what was, or would be, removed."""
    with chosen(args) as place:
        if not isinstance(place, InFolder):
            raise RefusedError(
                f"a running stack has the session {place.folder.name} open; end it with 'tagmill down', or open "
                "another session in it, before its bin is emptied",
                code="session_busy",
            )
        folder = place.folder
        samples = sorted(labelled(bin_of(folder)))
        size = 0
        if args.yes:
            size = place.locked(lambda: empty(folder, {name: recording_of(bin_of(folder), name) for name in samples}))
    if args.json:
        print(json.dumps({"ok": True, "removed": bool(args.yes), "samples": samples, "bytes": size}))
    elif args.yes:
        print(f"{len(samples)} removed from the bin of {folder.name} for good, {size / _MB:.1f} MB")
    else:
        print(f"{len(samples)} in the bin of {folder.name}; 'tagmill dataset empty-bin --yes' removes them for good")
    return EXIT_OK
