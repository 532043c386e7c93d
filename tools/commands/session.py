"""`tagmill session`: open or continue a session without a restart."""

from __future__ import annotations

import argparse

from tools.commands.client import ask, connected, finish

SESSION_S = 20.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which session."""
    parser.add_argument("name", help="a folder's name below the dataset's root")
    parser.add_argument(
        "--new-if-different", action="store_true", help="open NAME-2 ... where the rig differs from that session's"
    )


def run(args: argparse.Namespace) -> int:
    """Print the name of the session that is open now."""
    request = {"command": "session", "name": args.name, "new_if_different": args.new_if_different}
    with connected(args) as client:
        answer = ask(client, request, SESSION_S)
    if answer["ok"] and not args.json:
        print(f"session {answer['session']} is open")
    return finish(args, answer)
