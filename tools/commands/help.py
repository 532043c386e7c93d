"""`tagmill help`: the commands of the command socket with their fields, as the running stack understands them."""

from __future__ import annotations

import argparse
import json

from rich.console import Console
from rich.table import Table

from tools.commands.client import ask, connected, finish


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Optionally one command."""
    parser.add_argument("about", nargs="?", help="only this command")


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    with connected(args) as client:
        answer = ask(client, {"command": "help"})
    if args.json or not answer["ok"]:
        return finish(args, answer)
    console = Console()
    rows = answer["commands"]
    for name, row in rows.items():
        if args.about not in (None, name):
            continue
        console.print(f"[bold]{name}[/bold]  {row['words']}", highlight=False)
        if row["fields"]:
            console.print(_fields(row["fields"]))
    if args.about is not None and args.about not in rows:
        console.print(f"There is no command '{args.about}'; there are {', '.join(rows)}.", highlight=False)
    return finish(args, answer)


def _fields(fields: dict[str, dict[str, object]]) -> Table:
    table = Table(box=None, padding=(0, 2), show_header=False)
    for name, field in fields.items():
        table.add_row(f"  {name}", str(field["type"]), _default(field), str(field["words"]))
    return table


def _default(field: dict[str, object]) -> str:
    """Whether a field must be there, and what it is without."""
    if field["required"]:
        return "needed"
    return "may be left out" if field["default"] in (None, {}) else f"default {json.dumps(field['default'])}"
