"""What the proof shows: the paper's Table 3 for each training, the verdict, a sheet of the training pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from common.errors import DatasetError
from tools.proof.score import Score
from tools.proof.training import Recipe
from tools.report.sheet import Row, contact_sheet
from tools.report.table import print_table

REPORT = "proof.json"
REACH = 0.9
"""Erased pictures are to be worth so much of marker-free ones, in mAP50."""
_SHEET_ROWS = 12
_RED = (40, 40, 230)
Picture = NDArray[np.uint8]
Seconds = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Verdict:
    """``share``: mAP50 after erased pictures over that after marker-free ones; ``above_raw``: erased minus raw."""

    share: float
    above_raw: float

    @property
    def reached(self) -> bool:
        """Whether erasing works."""
        return self.share >= REACH and self.above_raw > 0.0


def judge(scores: Mapping[str, Score]) -> Verdict:
    """Compare the trainings."""
    free, erased, raw = (scores[name].map50 for name in ("marker-free", "erased", "raw"))
    return Verdict(erased / free if free > 0 else 0.0, erased - raw)


def show(console: Console, scores: Mapping[str, Score], verdict: Verdict, seconds: Seconds, out: Path) -> None:
    """Print tables, verdict and times."""
    for variant, found in scores.items():
        rows = [
            [
                row.name,
                str(row.pictures),
                *(f"{100 * n / max(row.pictures, 1):.1f}" for n in (row.correct, row.wrong, row.missed)),
                f"{found.ap50[row.name]:.3f}",
            ]
            for row in found.rows
        ]
        title = f"Trained on {variant}: mAP50 {found.map50:.3f}, {found.false_alarms} detections that hit nothing"
        print_table(console, title, ("side", "pictures", "correct %", "wrong %", "not detected %", "AP50"), rows)
    words = "reached" if verdict.reached else "NOT reached"
    console.print(
        f"In mAP50 erased is {verdict.share:.3f} of marker-free (to be reached: {REACH:g}) and "
        f"{verdict.above_raw:+.3f} against raw (to be reached: above 0): [bold]{words}[/]"
    )
    console.print(
        "Seconds (of CPU): " + ", ".join(f"{name} {wall:.0f} ({cpu:.0f})" for name, (wall, cpu) in seconds.items())
    )
    console.print(f"Figures: {out / REPORT}\nTraining pictures with their labels: {out / 'sheet.png'}", soft_wrap=True)


def plain(
    scores: Mapping[str, Score], verdict: Verdict, ledger: Mapping[str, Any], recipe: Recipe, seconds: Seconds
) -> dict[str, Any]:
    """Everything, JSON-able."""
    return {
        "scores": {variant: asdict(found) for variant, found in scores.items()},
        "verdict": {**asdict(verdict), "reached": verdict.reached},
        "recipe": asdict(recipe),
        "recorded": {
            name: {key: account[key] for key in ("captured", "recorded", "refused", "dropped")}
            for name, account in ledger["cameras"].items()
        },
        "seconds": {name: {"wall": round(wall, 1), "cpu": round(cpu, 1)} for name, (wall, cpu) in seconds.items()},
    }


def write_sheet(sets: Mapping[str, Path], names: Sequence[str], path: Path) -> None:
    """A few training pictures of all sets with the labels that the trainer reads, beside each other."""
    first = next(iter(sets.values())).parent
    pictures = sorted(file.relative_to(first) for file in first.glob("images/*/*.png"))
    rows = [
        Row(tuple(_with_label(data.parent / file, names) for data in sets.values()), file.stem)
        for file in pictures[:: max(len(pictures) // _SHEET_ROWS, 1)][:_SHEET_ROWS]
    ]
    if rows and not cv2.imwrite(str(path), contact_sheet("What the detectors were trained on", tuple(sets), rows)):
        raise DatasetError(f"{path} can't be written: is the disk full?")


def _with_label(path: Path, names: Sequence[str]) -> Picture:
    picture = np.asarray(cv2.imread(str(path)), dtype=np.uint8)
    size = np.array([picture.shape[1], picture.shape[0]])
    rows = (path.parents[2] / "labels" / path.parent.name / f"{path.stem}.txt").read_text().splitlines()
    for row in rows:
        kind, *numbers = row.split()
        centre, extent = np.array(numbers[:2], dtype=float) * size, np.array(numbers[2:], dtype=float) * size
        low, high = (np.rint(corner).astype(int).tolist() for corner in (centre - extent / 2, centre + extent / 2))
        cv2.rectangle(picture, low, high, _RED, 2)
        cv2.putText(picture, names[int(kind)], (low[0], low[1] - 8), cv2.FONT_HERSHEY_DUPLEX, 1.1, _RED, 2, cv2.LINE_AA)
    return picture
