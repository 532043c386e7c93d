"""Sessions on the disk without a store: whole samples with real pictures, written the same way."""

from __future__ import annotations

import json
from pathlib import Path

from common.dataset import LABELS, SESSION_FILE, SessionFile, SessionReader, label_path
from common.dataset.bin import bin_of, labelled
from common.dataset.durable import temporary_path
from common.labels import Label
from services.store.sample import write_sample
from tests.support.samples import label_for, pixels


def make_session(folder: Path, *labels: Label) -> tuple[str, ...]:
    """A session of these labels (with pictures that follow from their frame); returns their names."""
    for name in ("rgb", "depth", LABELS):
        (folder / name).mkdir(parents=True, exist_ok=True)
    file = SessionFile(name=folder.name, created_at="2026-08-30T12:00:00.000Z", rig={}, versions={})
    (folder / SESSION_FILE).write_bytes(file.to_bytes())
    for label in labels:
        colour, depth = pixels(label.frame)
        write_sample(folder, label, {"rgb": colour, "depth": depth, "original": 255 - colour}, reserve=0)
    return tuple(label.sample for label in labels)


def frames(*numbers: int) -> tuple[Label, ...]:
    """Labels of these frames."""
    return tuple(label_for(number) for number in numbers)


def places(session: Path) -> dict[str, str]:
    """Where each sample is, ``session`` or ``bin``; fails for one that is in both, or isn't whole, or left a file."""
    found: dict[str, str] = {}
    files = 0
    for place, folder in (("session", session), ("bin", bin_of(session))):
        if not folder.is_dir():
            continue
        reader = SessionReader(folder)
        for sample in labelled(folder):
            assert sample not in found, f"{sample} is in both places"
            found[sample] = place
            reader.verify(sample)
            files += 1 + sum(
                part is not None for part in json.loads((folder / label_path(sample)).read_text())["files"].values()
            )
    # A store that runs may be writing the ledger just now.
    beside = (SESSION_FILE, temporary_path(session / SESSION_FILE).name, "records.jsonl", "removed.jsonl")
    there = [path for path in session.rglob("*") if path.is_file() and path.name not in beside]
    assert len(there) == files, f"{len(there)} files, {files} named by labels: {there}"
    return found
