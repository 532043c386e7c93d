"""`tagmill keys`: the CURVE keys that a command socket off loopback needs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from common.bus import add_client, create_keys
from common.errors import EXIT_OK

DEFAULT_FOLDER = Path("keys")


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Where, and for whom."""
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT_FOLDER, help="where they go (default: ./keys)")
    parser.add_argument("--client", metavar="NAME", help="add a further client to existing keys")


def run(args: argparse.Namespace) -> int:
    """Make the keys, print the files; the secret ones are readable by their owner only."""
    made = add_client(args.folder, args.client) if args.client else create_keys(args.folder)
    if args.json:
        print(json.dumps({"ok": True, "files": [str(path) for path in made]}))
        return EXIT_OK
    for path in made:
        print(path)
    if not args.client:
        print(f"Name the folder in the rig file, network: {{keys: {args.folder}}}, and restart the stack.")
        print("A client on another machine needs server.key and a pair of its own:")
        print(f"  tagmill keys {args.folder} --client NAME")
    return EXIT_OK
