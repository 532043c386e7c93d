"""`tagmill doctor`: looks at everything on this machine that a stack needs, and says what to do."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from common.config import Rig, load_rig
from common.errors import EXIT_FOUND, EXIT_OK, ConfigError
from tools.doctor import disk, doors, memory, software
from tools.doctor.finding import Check, Finding, bad, good

CHECKS: tuple[Check, ...] = (
    software.versions,
    software.opencv,
    software.extras,
    software.clocks,
    memory.shared_memory,
    memory.main_memory,
    memory.limits,
    disk.dataset,
    disk.run_folder,
    doors.ports,
    memory.leftovers,
    doors.cameras,
)
_STYLES = {"good": "green", "warning": "yellow", "bad": "bold red"}


def add_parser(_parser: argparse.ArgumentParser) -> None:
    """Nothing to choose: ``--rig`` says for which rig."""


def run(args: argparse.Namespace) -> int:
    """Run all checks; exit code 5 if something keeps a stack from running or recording."""
    findings = examine(args.rig)
    fine = all(one.level != "bad" for one in findings)
    if args.json:
        print(json.dumps({"ok": fine, "findings": [asdict(one) for one in findings]}))
    else:
        show(findings, Console())
    return EXIT_OK if fine else EXIT_FOUND


def examine(path: Path | None) -> list[Finding]:
    """Everything that was found, in the order of CHECKS. A check that fails itself is told as such, and is bad."""
    rig, findings = _rig(path)
    for check in CHECKS:
        findings += _told(check, rig)
    return findings


def _rig(path: Path | None) -> tuple[Rig | None, list[Finding]]:
    if path is None:
        return None, []
    try:
        rig = load_rig(path, inputs=True)
    except ConfigError as error:
        count = len(error.problems)
        found = error.problems[0] + (f" (and {count - 1} more)" if count > 1 else "")
        return None, [bad("rig", found, f"tagmill check {path} says all that is wrong")]
    cameras = ", ".join(rig.config.cameras) or "no camera"
    objects = "1 object" if len(rig.boxes) == 1 else f"{len(rig.boxes)} objects"
    return rig, [good("rig", f"{path}: {objects}, {cameras}")]


def _told(check: Check, rig: Rig | None) -> Iterator[Finding]:
    try:
        yield from check(rig)
    except (OSError, ConfigError) as error:
        yield bad(check.__name__.replace("_", " "), f"can't be looked at: {error}", "may this user read it?")


def show(findings: list[Finding], console: Console) -> None:
    """A line each; below a line that isn't good, what to do."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for one in findings:
        words = escape(one.found) + (f"\n[bold]do:[/bold] {escape(one.cure)}" if one.cure else "")
        table.add_row(f"[{_STYLES[one.level]}]{one.level}", escape(one.about), words)
    console.print(table)
    counts = {level: sum(one.level == level for one in findings) for level in ("bad", "warning")}
    if counts["bad"]:
        console.print(f"{counts['bad']} to be mended before a stack runs well here, {counts['warning']} warnings")
    else:
        console.print(f"a stack can run here; {counts['warning']} warnings")
