"""What `merge`, `split` and `rename-class` share: naming sessions, making the new one, saying so."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from common.dataset.derive import Taken, derive
from common.dataset.faults import explain
from common.errors import EXIT_OK, RefusedError
from common.ids import NAME_PATTERN
from common.labels import Label
from tools.dataset.place import named_session


def add_rig(parser: argparse.ArgumentParser) -> None:
    """The rig file, below whose ``dataset.root`` sessions are looked for."""
    parser.add_argument(
        "--rig", type=Path, metavar="FILE", default=argparse.SUPPRESS, help="the rig file (default: ./rig.yaml)"
    )


def session_named(args: argparse.Namespace, name: str) -> Path:
    """A session by its name or folder; raises RefusedError ``unknown_session``."""
    return named_session(argparse.Namespace(rig=args.rig, session=name))


def beside(folder: Path, name: str) -> Path:
    """Where a new session goes: beside another; raises RefusedError ``bad_name``."""
    if not re.match(NAME_PATTERN, name):
        raise RefusedError(f"'{name}' can't be the name of a session", code="bad_name")
    return folder.resolve().parent / name


def make(
    target: Path,
    sources: Sequence[Taken],
    relabel: Callable[[Label], Label] = lambda label: label,
    describe: Callable[[dict[str, Any]], dict[str, Any]] = lambda rig: rig,
) -> int:
    """`derive`, with errors of the disk as refusals."""
    try:
        return derive(target, sources, relabel, describe)
    except OSError as error:
        told = explain(error, target.parent)
        raise RefusedError(told.message, code=told.code) from error


def tell(args: argparse.Namespace, made: Sequence[tuple[Path, int]]) -> int:
    """Say what was made, and how to undo it."""
    if args.json:
        print(json.dumps({"ok": True, "made": [{"session": str(path), "samples": count} for path, count in made]}))
        return EXIT_OK
    for path, count in made:
        print(f"{path.name}: {count} sample{'' if count == 1 else 's'} in {path}")
    print("What they were made of is unchanged; to undo it, remove the new folder" + ("s" if len(made) > 1 else ""))
    return EXIT_OK
