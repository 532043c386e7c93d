"""`tagmill status`: how the whole stack is, once or as a live table."""

from __future__ import annotations

import argparse
import json
import threading

from rich.console import Console
from rich.live import Live
from rich.text import Text

from common.bus import CommandClient
from common.errors import EXIT_OK, NoAnswerError
from tools.commands.client import ask, connected, finish
from tools.commands.show import status_view

STATUS = {"command": "status"}
EVERY_S = 1.0
WATCH_ANSWER_S = 2.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Once, or for as long as somebody looks."""
    parser.add_argument("--watch", action="store_true", help="a live table, until Ctrl-C; with --json a line a second")


def run(args: argparse.Namespace) -> int:
    """Print the status; with ``--watch`` once a second until Ctrl-C, through restarts of the stack."""
    with connected(args) as client:
        if args.watch:
            _watch(client, as_json=args.json)
            return EXIT_OK
        answer = ask(client, STATUS)
    if answer["ok"] and not args.json:
        Console().print(status_view(answer))
    return finish(args, answer)


def _watch(client: CommandClient, *, as_json: bool) -> None:
    pause = threading.Event()
    try:
        with Live(console=Console(quiet=as_json), auto_refresh=False, transient=False) as live:
            while True:
                try:
                    answer = ask(client, STATUS, WATCH_ANSWER_S)
                except NoAnswerError as error:
                    answer = {"ok": False, "error": {"code": error.code, "message": error.message}}
                if as_json:
                    print(json.dumps(answer), flush=True)
                elif answer["ok"]:
                    live.update(status_view(answer), refresh=True)
                else:
                    live.update(Text(answer["error"]["message"], style="yellow"), refresh=True)
                pause.wait(EVERY_S)
    except KeyboardInterrupt:
        return
