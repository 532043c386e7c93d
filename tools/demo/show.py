"""What the demo shows: the table against the truth, and the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from common.dataset import SessionReader
from common.labels import Label
from common.messages import TrueObject
from tools.report.compare import Difference, compare
from tools.report.overlay import draw_label
from tools.report.sheet import Row, contact_sheet

Truths = Mapping[tuple[str, int], tuple[TrueObject, ...]]
_GOOD_IOU = 0.9
_COLUMNS = ("as captured", "stored: markers erased", "its label")


def show(session: SessionReader, truths: Truths, sheet: Path, console: Console) -> bool:
    """Print the table and write the sheet; True if every sample was compared and fits the truth."""
    samples = session.samples()
    differences: dict[str, list[Difference]] = {}
    rows: list[Row] = []
    unknown = 0
    for name in samples:
        label = session.label(name)
        session.verify(label)
        truth = truths.get((label.camera.name, label.frame))
        if truth is None:
            unknown += 1
        else:
            differences.setdefault(label.camera.name, []).extend(compare(label.objects, truth))
        rows.append(_row(session, label))
    _write_sheet(sheet, rows)
    console.print(_table(differences))
    every = [item for group in differences.values() for item in group]
    good = sum(item.iou >= _GOOD_IOU for item in every)
    console.print(
        f"{len(samples)} samples, {len(every)} objects; window IoU above {_GOOD_IOU:g} for {good} of {len(every)}; "
        f"every file's checksum fits its label."
    )
    if unknown:
        console.print(f"{unknown} samples have no truth to compare with: its messages were missed.")
    return unknown == 0 and len(every) > 0 and good >= 0.95 * len(every)


def _row(session: SessionReader, label: Label) -> Row:
    erased = session.colour(label)
    original = session.original(label)
    pictures = (erased if original is None else original, erased, draw_label(erased, label))
    names = ", ".join(f"{item.name} {item.distance_mm:.0f} mm" for item in label.objects)
    return Row(pictures, f"{label.sample}   {names}")


def _write_sheet(path: Path, rows: list[Row]) -> None:
    picture = contact_sheet("tagmill: recorded samples", _COLUMNS, rows)
    coded, data = cv2.imencode(".png", picture)
    assert coded
    path.write_bytes(data.tobytes())


def _table(differences: Mapping[str, list[Difference]]) -> Table:
    table = Table(title="Labels against the renderer's truth")
    for heading in ("camera", "objects", "window IoU median", "least", "corner px median", "worst"):
        table.add_column(heading, justify="right")
    table.add_column("distance error mm median", justify="right")
    table.add_column("worst", justify="right")
    for camera, items in sorted(differences.items()):
        ious = [item.iou for item in items]
        corners = [item.corner_px for item in items]
        distances = [abs(item.distance_mm) for item in items]
        table.add_row(
            camera,
            str(len(items)),
            f"{np.median(ious):.4f}",
            f"{min(ious):.4f}",
            f"{np.median(corners):.2f}",
            f"{max(corners):.2f}",
            f"{np.median(distances):.2f}",
            f"{max(distances):.2f}",
        )
    return table
