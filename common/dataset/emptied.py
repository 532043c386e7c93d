"""Samples that were removed from the bin for good: ``bin/removed.jsonl`` remembers their names, one line each.

A name is written there before its files go. So a removal that a kill cut off is finished at the next start, the
ledger still adds up, and nothing that comes late can bring a removed sample back.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from common.bounded import parse_json
from common.dataset.bin import bin_of, labelled, names_in
from common.dataset.durable import append_bytes, sync_folder
from common.dataset.layout import FOLDERS, LABELS, sample_of_label, sample_of_picture
from common.dataset.layout import PICTURES as _PICTURES
from common.ids import is_sample_name

REMOVED_FILE = "removed.jsonl"


def removed(session: Path) -> dict[str, str | None]:
    """Names of the samples that were removed for good, each with its recording. Raises OSError."""
    path = bin_of(session) / REMOVED_FILE
    if not path.exists():
        return {}
    found: dict[str, str | None] = {}
    for line in path.read_bytes().splitlines():
        try:
            plain = parse_json(line)
        except ValueError:  # cut off by a kill: its sample was not touched yet
            continue
        if isinstance(plain, dict) and is_sample_name(str(plain.get("sample"))):
            recording = plain.get("recording")
            found[plain["sample"]] = recording if isinstance(recording, str) else None
    return found


def empty(session: Path, recordings: Mapping[str, str | None]) -> int:
    """Remove the bin's samples for good; ``recordings``: each one's recording. Returns the bytes. Raises OSError.

    The bin must be settled and the session locked.
    """
    known = removed(session)
    names = sorted(labelled(bin_of(session)) - known.keys())
    lines = [json.dumps({"sample": name, "recording": recordings.get(name)}).encode() + b"\n" for name in names]
    if lines:
        append_bytes(bin_of(session) / REMOVED_FILE, b"".join(lines))
    return finish_removal(session, {*known, *names})


def finish_removal(session: Path, names: Iterable[str]) -> int:
    """Remove what the bin still has of samples that were removed for good; returns the bytes. Raises OSError."""
    wanted, size = set(names), 0
    for folder in (bin_of(session) / name for name in FOLDERS):
        paths = [folder / name for name in names_in(folder) if _sample_of(folder.name, name) in wanted]
        for path in paths:
            size += path.stat().st_size
            path.unlink()
        if paths:
            sync_folder(folder)
    return size


def _sample_of(folder: str, name: str) -> str | None:
    if folder == LABELS:
        return sample_of_label(name)
    return next((sample_of_picture(kind, name) for kind in _PICTURES if kind == folder), None)
