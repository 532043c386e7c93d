"""What `delete` and `restore` share: the samples they are given, and what they print."""

from __future__ import annotations

import argparse
import sys

from tools.commands.client import finish
from tools.dataset.place import Plain, add_place, chosen

FROM_STDIN = "-"


def add_samples(parser: argparse.ArgumentParser) -> None:
    """Which samples, in which session."""
    add_place(parser)
    parser.add_argument(
        "samples", nargs="+", metavar="SAMPLE", help="a sample's name; '-' reads names from stdin, one a line"
    )


def move(args: argparse.Namespace, command: str, words: str) -> int:
    """Move them, and say so; ``words`` has room for the number."""
    samples = names_given(args.samples)
    with chosen(args) as place:
        answer: Plain = place.move(command, samples) if samples else {"ok": True, "samples": []}
        if not args.json and (answer["ok"] or answer.get("samples")):
            count = len(answer["samples"])
            what = "1 sample is" if count == 1 else f"{count} samples are"
            print(f"{what} {words} (session {place.folder.name})")
    return finish(args, answer)


def names_given(given: list[str]) -> list[str]:
    """The names that were typed, each once; '-' stands for those on stdin."""
    names: list[str] = []
    for name in given:
        names += [line.strip() for line in sys.stdin if line.strip()] if name == FROM_STDIN else [name]
    return list(dict.fromkeys(names))
