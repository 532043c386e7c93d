"""`tagmill export FORMAT SESSION... --out DIR`: a training set that the trainer's own loader accepts, or why not."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from common.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_REFUSED
from tools.dataset.deriving import session_named
from tools.export.check import Checks, check_export
from tools.export.options import add_options, folder_of, options_of
from tools.export.plan import Plan, left_out_words, plan_export
from tools.export.registry import known_formats, load_exporter
from tools.export.write import Done, Prepared, prepare, write


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The arguments."""
    parser.add_argument("format", metavar="FORMAT", help=", ".join(known_formats()))
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="a session's name below dataset.root, or folder")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="an empty folder, or an earlier export")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="threads (one a core)")
    parser.add_argument(
        "--check", action=argparse.BooleanOptionalAction, default=True, help="read it back and ask the official loader"
    )
    add_options(parser)


def run(args: argparse.Namespace) -> int:
    """Plan, write, check, tell."""
    cv2.setNumThreads(1)  # the threads are the parallelism
    options, exporter = options_of(args), load_exporter(args.format)
    folder, workers = folder_of(args.out), max(args.workers, 1)
    began = time.monotonic()
    console = Console(highlight=False, stderr=args.json)
    sessions = [folder_of(session_named(args, text)) for text in args.sessions]
    plan = plan_export(args.format, exporter, sessions, options, workers)
    with _bar(console, "labels", len(plan.export.shots)) as tick:
        prepared = prepare(folder, exporter, plan.export, workers, copy=options.pictures.copy, tick=tick)
    if not args.json:
        _show_plan(console, plan, prepared)
    try:
        with _bar(console, "files", len(prepared.missing)) as tick:
            done = write(prepared, plan.export, workers, tick)
    except KeyboardInterrupt:
        console.print("Interrupted: every file there is whole; the same command goes on where it stopped.")
        return EXIT_INTERRUPTED
    written_s = time.monotonic() - began
    checks = None
    if args.check:
        with _bar(console, "checks", 0) as tick:
            checks = check_export(folder, args.format, exporter, plan.export, tick)
    if args.json:
        print(json.dumps(_document(plan, prepared, done, checks, written_s, time.monotonic() - began)))
    else:
        _show_end(console, folder, done, checks, written_s, time.monotonic() - began - written_s)
    return EXIT_REFUSED if checks is not None and checks.failed else EXIT_OK


@contextmanager
def _bar(console: Console, what: str, total: int) -> Iterator[Callable[[], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total or None)
        yield lambda: progress.advance(task)


def _show_plan(console: Console, plan: Plan, prepared: Prepared) -> None:
    export = plan.export
    console.print(f"{len(export.shots)} of {plan.read} samples")
    for reason, count in sorted(plan.left_out.items(), key=lambda item: -item[1]):
        console.print(f"  left out {count}: {left_out_words(reason)}", style="dim")
    counts = Counter(target.class_name for shot in export.shots for target in shot.targets)
    console.print("classes: " + ", ".join(f"{name} ({counts[name]})" for name in export.classes), markup=False)
    empty = sum(not shot.targets for shot in export.shots)
    if empty:
        console.print(f"pictures without a target (negatives): {empty}")
    console.print("parts: " + ", ".join(f"{part} {len(export.of(part))}" for part in export.splits))
    for reason in plan.parted.reasons:
        console.print(f"  {reason}", style="dim")
    for note in plan.notes:
        console.print(f"note: {note}", style="yellow", markup=False)
    files = len(prepared.missing) + len(prepared.index_missing)
    links = 0 if prepared.copy else sum(file.link is not None for file in prepared.missing)
    how = f" ({links} pictures are linked, not copied)" if links else ""
    console.print(f"to write: {files} files, about {prepared.need / 1e6:.1f} MB{how}")


def _show_end(
    console: Console, folder: Path, done: Done, checks: Checks | None, written_s: float, checked_s: float
) -> None:
    words = f"{done.written} files written ({done.linked} linked), {done.kept} kept, {done.removed} removed"
    console.print(f"{folder}: {words}, {written_s:.2f} s", soft_wrap=True, markup=False)
    if checks is None:
        console.print("nothing was checked (--no-check)", style="yellow")
        return
    for line in checks.done:
        console.print(f"  checked: {line}", style="green", markup=False, soft_wrap=True)
    for line in checks.absent:
        console.print(f"  not checked: {line}", style="yellow", markup=False, soft_wrap=True)
    for line in checks.failed:
        console.print(f"  WRONG: {line}", style="bold red", markup=False, soft_wrap=True)
    console.print(f"checked in {checked_s:.2f} s")


def _document(
    plan: Plan, prepared: Prepared, done: Done, checks: Checks | None, written_s: float, whole_s: float
) -> dict[str, Any]:
    counts = Counter(target.class_name for shot in plan.export.shots for target in shot.targets)
    return {
        "ok": checks is None or not checks.failed,
        "folder": str(prepared.folder),
        "samples": {part: len(plan.export.of(part)) for part in plan.export.splits},
        "classes": {name: counts[name] for name in plan.export.classes},
        "left_out": dict(plan.left_out),
        "split": plan.export.stated["split"],
        "notes": list(plan.notes),
        "files": {"written": done.written, "linked": done.linked, "kept": done.kept, "removed": done.removed},
        "need_bytes": prepared.need,
        "checks": None
        if checks is None
        else {"right": checks.done, "wrong": checks.failed, "not_checked": checks.absent, **checks.figures},
        "seconds": {"written": round(written_s, 3), "checked": round(whole_s - written_s, 3)},
    }
