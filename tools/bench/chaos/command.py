"""`tagmill bench chaos`: recordings from two cameras while everything goes wrong, then an independent judge.

The plan of faults follows from the seed; --plan prints it.
"""

# Beside this: plan.py (what), storm.py (when), faults.py (how), checker.py (the judge).

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console

from common.clock import monotonic_ns
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_USAGE, TagmillError
from tools.bench.chaos.checker import Verdict, check
from tools.bench.chaos.client import Clients, Journal
from tools.bench.chaos.ground import SESSION, Ground, clear, prepare
from tools.bench.chaos.plan import Fault, make_plan
from tools.bench.chaos.stack import Stack
from tools.bench.chaos.storm import Storm
from tools.bench.chaos.truth import write_truth
from tools.report.table import print_table

_OWN_MOUNTS = ("unshare", "--mount", "--map-root-user")
_INSIDE = "TAGMILL_CHAOS_MOUNTS"


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The benchmark's own arguments."""
    parser.add_argument("--seed", type=int, default=1, help="the plan of faults follows from it (1)")
    parser.add_argument("--faults", type=int, default=200, help="how many (200: about half an hour)")
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="begin no further fault after so many minutes"
    )
    parser.add_argument(
        "--short", action="store_true", help="only the cheap faults, each a third as long, without the operator's page"
    )
    parser.add_argument("--plan", action="store_true", help="print the plan of faults and stop")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="copy log, dataset and services' logs there")


@dataclass(frozen=True)
class Result:
    """A whole run. ``left_out``: faults that need mounts, where those aren't allowed."""

    seed: int
    faults: int
    left_out: int
    seconds: float
    violations: list[str]
    counts: dict[str, int]


def run(args: argparse.Namespace) -> int:
    """Let it happen, judge, print; exit code 5 if anything was lost, torn or left."""
    if args.faults < 1 or (args.keep is not None and args.keep.exists()):
        print("bench chaos: --faults is at least 1, and the folder of --keep must not exist")
        return EXIT_USAGE
    plan = make_plan(args.seed, args.faults, short=args.short)
    if args.plan:
        _print_plan(plan, as_json=args.json)
        return EXIT_OK
    if _INSIDE not in os.environ and _may_mount():
        _go_inside()
    with tempfile.TemporaryDirectory(prefix="tagmill-chaos-") as folder:
        os.environ["TAGMILL_RUN_DIR"] = folder
        os.environ["TAGMILL_PREFIX"] = f"chaos-{os.getpid()}"
        ground = prepare(Path(folder) / "ground", console=not args.short)
        try:
            os.environ["TAGMILL_SHM_DIR"] = str(ground.shm)
            result = _run(ground, plan, args)
            if args.keep is not None:
                _keep(ground, args.keep)
        finally:
            clear(ground)
    print(json.dumps(asdict(result))) if args.json else _print(result)
    return EXIT_FOUND if result.violations else EXIT_OK


def _run(ground: Ground, plan: tuple[Fault, ...], args: argparse.Namespace) -> Result:
    began_ns = monotonic_ns()
    write_truth(ground.rig, ground.truth)
    stack, journal = Stack(ground), Journal(ground.journal)
    storm = Storm(stack, journal, lambda line: print(line, file=sys.stderr, flush=True))
    try:
        stack.up()
        try:
            stack.wait_ready()
            with Clients(stack.endpoints, journal, args.seed, short=args.short) as clients:
                storm.run(plan, clients, 60 * args.minutes)
            _calm(stack, storm, journal)
        except TagmillError as error:
            journal.write(not_recovered=error.message)
        finally:
            stack.over.set()
            stack.down()
    except TagmillError as error:
        journal.write(not_recovered=error.message)
    finally:
        journal.close()
    verdict: Verdict = check(ground.folder, SESSION, stack.endpoints.prefix, stack.endpoints.run_dir)
    seconds = round((monotonic_ns() - began_ns) / 1e9, 1)
    return Result(args.seed, storm.done, storm.left_out, seconds, verdict.violations, verdict.counts)


def _calm(stack: Stack, storm: Storm, journal: Journal) -> None:
    """After the storm: all is well again, the recordings are ended and settled."""
    from common.bus import CommandClient

    stack.wait_ready()
    storm.record(count=8)
    with CommandClient(stack.endpoints) as client:
        journal.ask(client, {"command": "stop"}, 60.0)


def _may_mount() -> bool:
    with suppress(FileNotFoundError):
        return subprocess.run([*_OWN_MOUNTS, "true"], capture_output=True, check=False).returncode == 0
    return False


def _go_inside() -> None:
    """Go on in a mount namespace of our own, in which small disks can be mounted and vanish by themselves."""
    os.environ[_INSIDE] = "1"
    os.execvp(_OWN_MOUNTS[0], [*_OWN_MOUNTS, sys.executable, "-m", "tools", *sys.argv[1:]])  # noqa: S606 - itself


def _keep(ground: Ground, folder: Path) -> None:
    shutil.copytree(ground.folder, folder, ignore=shutil.ignore_patterns("shm"))
    run_dir = Stack(ground).endpoints.run_dir
    shutil.copytree(run_dir / "log", folder / "log", dirs_exist_ok=True)


def _print_plan(plan: tuple[Fault, ...], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps([asdict(fault) for fault in plan]))
        return
    rows = [
        [str(one.number + 1), one.kind, one.target, f"{one.gap_s:g}", f"{one.lasts_s:g}", f"{one.amount:g}"]
        for one in plan
    ]
    print_table(Console(highlight=False), "The plan", ("", "fault", "of", "after s", "for s", "amount"), rows)


def _print(result: Result) -> None:
    rows = [[what, str(count)] for what, count in result.counts.items()]
    title = f"Chaos, seed {result.seed}: {result.faults} faults in {result.seconds:.0f} s"
    print_table(Console(highlight=False), title, ("", "count"), rows)
    if result.left_out:
        print(f"{result.left_out} faults were left out: they need small disks of their own (unshare, mount)")
    print(f"{len(result.violations)} violations")
    for line in result.violations:
        print(f"  {line}")
