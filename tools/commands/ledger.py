"""`tagmill ledger`: what became of every frame of a recording."""

from __future__ import annotations

import argparse

from rich.console import Console

from tools.commands.client import ask, connected, finish
from tools.commands.show import ledger_view

LEDGER_S = 10.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which recording."""
    parser.add_argument("recording", help="its id, as 'tagmill start' printed it")


def run(args: argparse.Namespace) -> int:
    """Print the ledger."""
    with connected(args) as client:
        answer = ask(client, {"command": "ledger", "recording": args.recording}, LEDGER_S)
    if answer["ok"] and not args.json:
        Console().print(ledger_view(answer["ledger"]))
    return finish(args, answer)
