"""`tagmill undo`: the newest sample goes to the session's bin; asked again, the one before it."""

from __future__ import annotations

import argparse

from tools.commands.client import ask, connected, finish

UNDO_S = 65.0
"""Control asks the store twice, 30 s each."""


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Of which camera."""
    parser.add_argument("--camera", help="the newest sample of this camera (default: of all)")


def run(args: argparse.Namespace) -> int:
    """Print the sample's name."""
    with connected(args) as client:
        answer = ask(client, {"command": "undo", "camera": args.camera}, UNDO_S)
    if answer["ok"] and not args.json:
        for sample in answer["samples"]:
            print(f"{sample} is in the bin; 'tagmill dataset restore {sample}' puts it back")
    return finish(args, answer)
