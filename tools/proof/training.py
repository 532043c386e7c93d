"""Starts the trainer, a program of another environment, on one set of pictures after the other."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from common.errors import TagmillError

TRAINER = Path(__file__).with_name("trainer.py")
_LIMIT_S = 7200.0


@dataclass(frozen=True)
class Recipe:
    """How to train: passes over the pictures, the network's picture (px), pictures a step, AdamW's rate, seed."""

    epochs: int = 20
    width: int = 256
    height: int = 192
    batch: int = 8
    rate: float = 0.001
    seed: int = 0

    def arguments(self) -> tuple[str, ...]:
        """For the trainer's command line."""
        return tuple(f"--{name}={value}" for name, value in vars(self).items())


def interpreter(path: Path) -> Path:
    """The Python of the trainer's environment; raises TagmillError if it can't train."""
    path = path.absolute()
    how = "`make proof` makes it; --trainer names the python of another environment with libreyolo"
    if not os.access(path, os.X_OK):
        raise TagmillError(f"there is no trainer's environment ({path}): {how}")
    done = subprocess.run(
        [str(path), "-c", "import libreyolo"], capture_output=True, text=True, timeout=600, check=False
    )
    if done.returncode != 0:
        why = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1]
        raise TagmillError(f"{path} can't train: {why}; {how}")
    return path


def train(python: Path, sets: Mapping[str, Path], truth: Path, out: Path, recipe: Recipe) -> dict[str, Path]:
    """Train on each ``data.yaml``, all side by side, and look at the pictures of ``truth``; files of what was found.

    Raises TagmillError if the trainer fails; what it wrote is ``out/train-VARIANT.log``.
    """
    with ThreadPoolExecutor(len(sets)) as pool:
        jobs = {name: pool.submit(_train, python, name, data, truth, out, recipe) for name, data in sets.items()}
    return {name: job.result() for name, job in jobs.items()}


def _train(python: Path, variant: str, data: Path, truth: Path, out: Path, recipe: Recipe) -> Path:
    found, log = out / f"found-{variant}.json", out / f"train-{variant}.log"
    command = [str(python), str(TRAINER), str(data), str(truth), str(found), *recipe.arguments()]
    try:
        with log.open("w") as sink:
            done = subprocess.run(command, stdout=sink, stderr=subprocess.STDOUT, timeout=_LIMIT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise TagmillError(f"training on the {variant} pictures did not end in {_LIMIT_S:g} s; see {log}") from error
    if done.returncode != 0 or not found.exists():
        last = (log.read_text(errors="replace").strip().splitlines() or ["it ended without a word"])[-1]
        raise TagmillError(f"training on the {variant} pictures failed: {last}; see {log}")
    return found
