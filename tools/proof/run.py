"""The proof's script: render, record, export, train three times, judge on pictures that never had a marker."""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from common.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_REFUSED, EXIT_USAGE, TagmillError
from tools.proof.record import CAMERA_NAME, export, record
from tools.proof.scenes import Room, class_names, render_test, render_training
from tools.proof.score import score
from tools.proof.show import REPORT, judge, plain, show, write_sheet
from tools.proof.training import Recipe, interpreter, train
from tools.stack.running import interrupt_by_sigterm

_TEST_SEEDS = 50_000
"""Seeds of rooms that no training has seen begin here."""


def main(argv: list[str] | None = None) -> int:
    """Run the proof; 0 if training on erased pictures is nearly as good as on marker-free ones, and better than raw."""
    args = _arguments(argv)
    interrupt_by_sigterm()
    console = Console(highlight=False)
    out: Path = args.out.resolve()
    if out.exists() and any(out.iterdir()) and not (out / "frames").is_dir():
        console.print(f"{out} holds something else than an earlier proof; name another folder with --out.")
        return EXIT_USAGE
    try:
        python = interpreter(args.trainer)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        return _prove(args, python, out, console)
    except TagmillError as error:
        console.print(f"[bold]The proof failed:[/] {error.message}", soft_wrap=True)
        return error.exit_code
    except KeyboardInterrupt:
        console.print(f"Interrupted. What there is lies in {out}; the next run begins anew.")
        return EXIT_INTERRUPTED


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    recipe = Recipe()
    parser = argparse.ArgumentParser(prog="python -m tools.proof", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("proof-out"), help="folder for pictures, sets and figures")
    parser.add_argument("--trainer", type=Path, default=Path(".venv-proof/bin/python"), help="Python with libreyolo")
    parser.add_argument("--rooms", type=int, default=18, help="rooms to record in")
    parser.add_argument("--frames", type=int, default=25, help="frames a room")
    parser.add_argument("--test-rooms", type=int, default=20, help="other rooms for the held-out pictures")
    parser.add_argument("--test", type=int, default=500, help="held-out pictures a class")
    parser.add_argument("--epochs", type=int, default=recipe.epochs, help="passes over the training pictures")
    parser.add_argument("--seed", type=int, default=1, help="of rooms and trainings")
    return parser.parse_args(argv)


def _prove(args: argparse.Namespace, python: Path, out: Path, console: Console) -> int:
    workers = os.cpu_count() or 1
    recipe = Recipe(epochs=args.epochs, seed=args.seed)
    frames, truth = out / "frames", out / "truth.json"
    rooms = [Room(frames, 100 * args.seed + number) for number in range(args.rooms)]
    others = [Room(out / "test", _TEST_SEEDS + 100 * args.seed + number) for number in range(args.test_rooms)]
    seconds: dict[str, tuple[float, float]] = {}
    with _timed(seconds, "rendering"):
        console.print(
            f"Rendering {args.rooms * args.frames} frames, with and without markers, and the held-out ones ..."
        )
        render_training(rooms, args.frames, workers)
        render_test(others, max(args.test // args.test_rooms, 1), truth, workers)
    with _timed(seconds, "recording and export"):
        console.print("Recording what the camera sees with the stack, and exporting it ...")
        recorded = record(frames, out)
        sets = export(recorded, frames, out)
    account = recorded.ledger["cameras"][CAMERA_NAME]
    console.print(f"{account['captured']} frames captured, {account['recorded']} recorded")
    write_sheet(sets, class_names(), out / "sheet.png")
    with _timed(seconds, "three trainings and their tests"):
        console.print(f"Training on {', '.join(sets)} pictures, side by side (each writes {out}/train-*.log) ...")
        found = train(python, sets, truth, out, recipe)
    scores = {variant: score(truth, file) for variant, file in found.items()}
    verdict = judge(scores)
    document = plain(scores, verdict, recorded.ledger, recipe, seconds)
    (out / REPORT).write_text(json.dumps(document, indent=2) + "\n")
    show(console, scores, verdict, seconds, out)
    return EXIT_OK if verdict.reached else EXIT_REFUSED


@contextmanager
def _timed(seconds: dict[str, tuple[float, float]], step: str) -> Iterator[None]:
    """Keep a step's wall seconds and the CPU seconds of all its processes that have ended."""
    wall, cpu = time.monotonic(), _cpu_s()
    yield
    seconds[step] = (time.monotonic() - wall, _cpu_s() - cpu)


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)
