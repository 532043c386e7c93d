"""`tagmill stop`: end a recording, or all that run, and print the ledgers once everything is durable."""

from __future__ import annotations

import argparse

from rich.console import Console

from tools.commands.client import AFTER_S, ask, connected, finish
from tools.commands.show import ledger_view

STOP_S = 35.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which recording."""
    parser.add_argument("recording", nargs="?", help="its id; without it, all that run")


def run(args: argparse.Namespace) -> int:
    """Print a ledger for each recording that was ended."""
    with connected(args) as client:
        answer = ask(client, {"command": "stop", "recording": args.recording}, STOP_S + AFTER_S)
    if not args.json:
        console = Console()
        for ledger in answer.get("ledgers", ()):
            console.print(ledger_view(ledger))
        if answer["ok"] and not answer["ledgers"]:
            console.print("Nothing was being recorded.")
    return finish(args, answer)
