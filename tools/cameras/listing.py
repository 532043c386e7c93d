"""What is attached, by driver, and what a driver lacks."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict

import psutil
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from common.errors import EXIT_OK
from services.capture.attached import DEADLINE_S, Found, ask_drivers

IN_ALL_S = 2.6
"""From the start of this process to the answer; a slow start leaves the drivers less time."""
AT_LEAST_S = 0.8


def add_parser(_parser: argparse.ArgumentParser) -> None:
    """Nothing to choose."""


def run(args: argparse.Namespace) -> int:
    """Ask all drivers, print what they say."""
    age_s = time.time() - psutil.Process().create_time()
    found = ask_drivers(deadline_s=min(DEADLINE_S, max(AT_LEAST_S, IN_ALL_S - age_s)))
    if args.json:
        print(json.dumps({"ok": True, "drivers": [asdict(item) for item in found]}))
    else:
        show(found, Console())
    return EXIT_OK


def show(found: tuple[Found, ...], console: Console) -> None:
    """A table of the cameras; below it what is wrong, a line each, and the drivers that need no camera."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("driver", "camera", "serial", "address", "modes"):
        table.add_column(column, overflow="fold")
    for item in found:
        for camera in item.cameras:
            words = (camera.driver, camera.name, camera.serial, camera.address, ", ".join(camera.modes))
            table.add_row(*map(escape, words))
    if table.row_count:
        console.print(table)
    else:
        console.print("No camera is attached that a driver can open.")
    for item in found:
        notes = [f"{camera.name} {camera.address}: {camera.note}" for camera in item.cameras if camera.note]
        problem = () if item.problem is None else (item.problem,)
        for line in (*notes, *problem, *item.hints):
            console.print(f"! {item.driver}: {line}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    quiet = [item.driver for item in found if item.lists and item.problem is None and not item.cameras]
    if quiet:
        console.print(f"none attached: {', '.join(quiet)}", highlight=False)
    unlisted = [item.driver for item in found if not item.lists]
    if unlisted:
        console.print(f"named in the rig file only: {', '.join(unlisted)}", highlight=False)
