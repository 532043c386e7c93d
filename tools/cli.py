"""The console script `tagmill`: a table of sub-commands, each a module that is imported only when it is called.

A sub-command's module has ``add_parser(parser)``, which gives the sub-command's own parser its arguments, and
``run(args) -> int``, which returns the exit code. ``--rig`` and ``--json`` are given to all of them here
(``args.rig``: Path or None, ``args.json``: bool). An expected error (`TagmillError`) that leaves ``run`` is shown
with what to do about it, and ends with that error's exit code.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from common.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE, ConfigError, TagmillError

DEFAULT_RIG = Path("rig.yaml")


class SubCommand(NamedTuple):
    """A row of the table: what is typed, the module behind it, one line of help."""

    name: str
    module: str
    help: str


SUB_COMMANDS = (
    SubCommand("up", "tools.stack.up", "start the stack of a rig and stay in the foreground"),
    SubCommand("down", "tools.stack.down", "stop the stack and clear what it left behind"),
    SubCommand("status", "tools.commands.status", "services, cameras, recordings, backlog, free disk"),
    SubCommand("record", "tools.commands.record", "record one or more samples now, wait until they are durable"),
    SubCommand("start", "tools.commands.start", "start a recording"),
    SubCommand("stop", "tools.commands.stop", "end a recording (or all) and print the ledger"),
    SubCommand("ledger", "tools.commands.ledger", "what became of every frame of a recording"),
    SubCommand("undo", "tools.commands.undo", "move the newest sample to the session's bin"),
    SubCommand("dataset", "tools.dataset.command", "list samples, delete them to the bin, restore them"),
    SubCommand(
        "inspect", "tools.inspect.command", "what is in a session, which samples look wrong, which files are broken"
    ),
    SubCommand("view", "tools.view.command", "look at a session in the Rerun viewer, or write a file for it"),
    SubCommand(
        "relabel",
        "tools.relabel.command",
        "make labels and pictures again from the originals, by another rig",
    ),
    SubCommand("session", "tools.commands.session", "open or continue a session"),
    SubCommand("reload", "tools.commands.reload", "check the changed rig file and let the stack take it over"),
    SubCommand("preview", "tools.commands.preview", "keep the inpainted preview of a camera going"),
    SubCommand("help", "tools.commands.help", "the commands of the command socket with their fields"),
    SubCommand("cameras", "tools.cameras.command", "which cameras are attached; how one of them does alone"),
    SubCommand("check", "tools.check", "say all mistakes of a rig file at once"),
    SubCommand("markers", "tools.markers.command", "print markers and calibration boards at true scale"),
    SubCommand(
        "calibrate", "tools.calibrate.command", "calibrate a camera from pictures of a board, and say how good it is"
    ),
    SubCommand(
        "export", "tools.export.command", "make a training set of sessions in a trainer's own format, and check it"
    ),
    SubCommand("bench", "tools.bench.command", "measure the real stack on this machine"),
    SubCommand("evaluate", "tools.evaluate.command", "measure labels and erased pictures against the truth"),
    SubCommand("log", "tools.commands.log", "how much the services log, changed while they run"),
    SubCommand("doctor", "tools.doctor.command", "check this machine, and say what to do"),
    SubCommand("keys", "tools.commands.keys", "make the CURVE keys that a command socket off loopback needs"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; returns its exit code (see docs/reference/cli.md)."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        # Inside: half a second of a sub-command's start is its imports, and Ctrl-C may come then too.
        return _run(words)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output (`| head`) has gone; the interpreter's last flush must not complain either.
        sys.stdout = None
        return EXIT_OK


def _run(words: Sequence[str]) -> int:
    parser, modules = build_parser(words)
    args = parser.parse_args(words)
    if args.sub_command is None:
        parser.print_help()
        return EXIT_USAGE
    if args.rig is None and DEFAULT_RIG.is_file():
        args.rig = DEFAULT_RIG
    try:
        code: int = modules[args.sub_command].run(args)
    except TagmillError as error:
        show_error(error, as_json=args.json)
        return error.exit_code
    return code


def build_parser(words: Sequence[str]) -> tuple[argparse.ArgumentParser, dict[str, ModuleType]]:
    """The parser for these words, and the modules it needed: only the called sub-command's is imported."""
    parser = argparse.ArgumentParser(
        prog="tagmill",
        description="Turns a camera and a few printed markers into a labelled, marker-free training set.",
        epilog="exit codes: 0 done, 2 wrong usage, 3 refused, 4 no answer, 5 found something wrong, 78 bad rig file",
    )
    rows = parser.add_subparsers(dest="sub_command", metavar="COMMAND", title="commands")
    called = next((word for word in words if not word.startswith("-")), None)
    modules: dict[str, ModuleType] = {}
    for row in SUB_COMMANDS:
        own = rows.add_parser(row.name, help=row.help, description=row.help[:1].upper() + row.help[1:] + ".")
        own.add_argument("--rig", type=Path, metavar="FILE", help="the rig file (default: ./rig.yaml, if there is one)")
        own.add_argument("--json", action="store_true", help="print one JSON document instead of words")
        if row.name == called:
            modules[row.name] = _imported(row.module)
            modules[row.name].add_parser(own)
    return parser, modules


def _imported(module: str) -> ModuleType:
    """A sub-command's module; imports make no garbage, and looking for some takes a seventh of their time."""
    looking = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        if looking:
            gc.enable()


def show_error(error: TagmillError, *, as_json: bool) -> None:
    """An expected error: as JSON on stdout, or in words on stderr."""
    problems = list(error.problems) if isinstance(error, ConfigError) else []
    if as_json:
        document = {"ok": False, "error": {"code": error.code, "message": error.message}}
        print(json.dumps(document | ({"problems": problems} if problems else {})))
        return
    from common.words import words_for

    words = words_for(error.code)
    print(words.title, file=sys.stderr)
    for line in [error.message, *(problem for problem in problems if problem != error.message)]:
        print(f"  {line}", file=sys.stderr)
    if words.what_to_do:
        print(words.what_to_do, file=sys.stderr)
