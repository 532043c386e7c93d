"""Make labels and pictures again from the originals, with another rig, calibration or tagmill version.

Each SESSION becomes a new one beside it; the old one stays as it is. It must have been recorded with
`dataset: {keep_original: true}`. A run that was cut off (Ctrl-C too) is gone on with by the same command.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from common.dataset import read_session
from common.errors import EXIT_INTERRUPTED, EXIT_OK, RefusedError
from tools.dataset.deriving import beside, session_named
from tools.relabel.diff import MEASURES, Difference, difference
from tools.relabel.recipe import Recipe, recipe_of
from tools.relabel.session import Done, Tick, relabel
from tools.report.table import print_table

_SUFFIX = "-relabelled"
_SHOWN = 5
_WORDS = {
    "no_original": "recorded without the original",
    "ambiguous_pose": "an ambiguous pose",
    "no_object": "no object with a pose",
    "incomplete": "an object without a pose",
    "object_in_view": "recorded as background, but an object is in view",
    "damaged": "a damaged file",
    "missing_file": "a missing file",
    "camera": "a calibration of another picture size",
}


def add_parser(parser: argparse.ArgumentParser) -> None:
    """Which sessions, and by what."""
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="a session's name below dataset.root, or folder")
    parser.add_argument(
        "--as-recorded", action="store_true", help="by the session's own rig, also if there is a ./rig.yaml"
    )
    parser.add_argument(
        "--calibration",
        action="append",
        default=[],
        metavar="[CAMERA=]FILE",
        help="a camera's calibration instead of the one it was recorded with (again for further cameras)",
    )
    parser.add_argument("--into", metavar="NAME", help=f"the new session's name (default: SESSION{_SUFFIX})")
    parser.add_argument("--diff", action="store_true", help="show what moved, and by how much")


def run(args: argparse.Namespace) -> int:
    """Session by session."""
    if args.into is not None and len(args.sessions) > 1:
        raise RefusedError("--into names one session; without it each gets its own name", code="refused")
    console = Console(stderr=args.json)
    documents = []
    for name in args.sessions:
        folder = session_named(args, name)
        target = beside(folder, args.into or folder.resolve().name + _SUFFIX)
        recipe = recipe_of(read_session(folder), folder, None if args.as_recorded else args.rig, args.calibration)
        if not args.json:
            _show_recipe(console, folder, recipe)
        try:
            with _bar(console) as begin:
                done = relabel(folder, target, recipe, begin)
        except KeyboardInterrupt:
            console.print("Interrupted: what was made is kept aside; the same command goes on where it stopped.")
            return EXIT_INTERRUPTED
        moved = difference(folder, target) if args.diff else None
        documents.append(_document(done, recipe, moved))
        if not args.json:
            _show(console, done, moved)
    if args.json:
        print(json.dumps({"ok": True, "made": documents}))
    return EXIT_OK


@contextmanager
def _bar(console: Console) -> Iterator[Callable[[int], Tick]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:

        def begin(total: int) -> Tick:
            task = progress.add_task("samples", total=total)
            return lambda: progress.advance(task)

        yield begin


def _show_recipe(console: Console, folder: Path, recipe: Recipe) -> None:
    console.print(f"{folder.resolve().name} by {recipe.source}", markup=False, soft_wrap=True)
    for line in recipe.changes or ("objects, markers and calibrations are those of the recording",):
        console.print(f"  {line}", style="dim", markup=False, soft_wrap=True)


def _show(console: Console, done: Done, moved: Difference | None) -> None:
    if done.unchanged:
        words = "is there already, made of the same by the same; nothing was changed"
    else:
        words = f"{done.made} samples" + (f", {done.before} of them by an earlier run" if done.before else "")
    console.print(f"{done.target}: {words}", markup=False, soft_wrap=True)
    for code, count in done.left_out.most_common():
        console.print(f"  left out {count}: {_WORDS.get(code, code.replace('_', ' '))}", style="yellow", markup=False)
    for sample, sentence in list(done.sentences.items())[:_SHOWN]:
        console.print(f"    {sample}: {sentence}", style="dim", markup=False, soft_wrap=True)
    if moved is not None:
        _show_difference(console, moved)


def _show_difference(console: Console, moved: Difference) -> None:
    console.print(
        f"of {moved.both} samples in both, {moved.same_labels} have the same objects to the last digit and "
        f"{moved.same_pictures} the same picture to the last byte"
    )
    for words, pairs in (("no longer found", moved.gone), ("newly found", moved.new)):
        for sample, name in pairs[:_SHOWN]:
            console.print(f"  {name} {words} in {sample}", style="yellow", markup=False, soft_wrap=True)
        if len(pairs) > _SHOWN:
            console.print(f"  and {len(pairs) - _SHOWN} more {words}", style="yellow")
    rows = []
    for name, item in sorted(moved.moved.items()):
        summary = item.summary()
        for measure, (title, unit) in MEASURES.items():
            if measure in summary:
                found = summary[measure]
                numbers = (f"{found[key]:.2f} {unit}" for key in ("median", "p95", "largest"))
                rows.append([f"{name}: {title}", *numbers, found["sample"] if found["largest"] else ""])
    print_table(console, "moved", ("", "median", "95 % below", "largest", "in sample"), rows)


def _document(done: Done, recipe: Recipe, moved: Difference | None) -> dict[str, Any]:
    return {
        "session": str(done.target),
        "rig": recipe.source,
        "changes": list(recipe.changes),
        "samples": done.made,
        "made_before": done.before,
        "unchanged": done.unchanged,
        "left_out": dict(done.left_out),
        "sentences": done.sentences,
        **({} if moved is None else {"moved": moved.plain()}),
    }
