"""What a killed store left behind: found and removed at the start, before anything new is written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from common.dataset.bin import bin_of, settle
from common.dataset.durable import is_temporary, sync_folder
from common.dataset.emptied import finish_removal, removed
from common.dataset.head import read_recording, recording_of
from common.dataset.layout import FOLDERS, LABELS, PICTURES, label_path, sample_of_label, sample_of_picture
from common.errors import DatasetError
from common.ids import sample_camera

MOST_HALF_WRITTEN = 16
"""A crash leaves at most one sample a worker. More pictures without labels are no crash's: they stay."""


@dataclass
class Inventory:
    """What is in a session after recovery.

    ``samples``: the names of all whole samples. ``recorded``: of each recording, samples a camera.
    ``removed``: the half-written files that were removed, relative to the session. ``orphans``: pictures without
    a label that were too many to be a crash's and were left alone. ``damaged``: samples whose label can't be read or
    whose colour picture is missing; they are left as they are.
    ``binned``: the samples in the bin; ``emptied``: those that were removed from it for good. Both were recorded too;
    ``deleted``: of each recording, how many a camera. ``settled``: files of a cut off move, now at their label.
    """

    samples: set[str] = field(default_factory=set)
    binned: set[str] = field(default_factory=set)
    emptied: set[str] = field(default_factory=set)
    recorded: dict[str, Counter[str]] = field(default_factory=dict)
    deleted: dict[str, Counter[str]] = field(default_factory=dict)
    settled: list[str] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    orphans: int = 0
    damaged: list[str] = field(default_factory=list)


def recover(session: Path) -> Inventory:
    """Remove half-written samples and take stock; the caller keeps writers away meanwhile.

    Raises OSError.
    """
    found = Inventory()
    for folder in (session, *(session / name for name in FOLDERS)):
        _remove_temporary_files(session, folder, found)
    _settle_bin(session, found)
    for name in _names(session / LABELS):
        sample = sample_of_label(name)
        if sample is not None:
            found.samples.add(sample)
            _count(session, sample, found)
    _remove_pictures_without_label(session, found)
    for name in FOLDERS:
        # A sample that was complete but not yet answered for is answered for from now on: make its name durable.
        if (session / name).is_dir():
            sync_folder(session / name)
    return found


def _settle_bin(session: Path, found: Inventory) -> None:
    """Finish what a kill cut off between the session and its bin, before pictures without a label are removed."""
    gone = removed(session)
    finish_removal(session, gone)
    settled = settle(session)
    found.binned, found.emptied, found.settled = settled.samples, set(gone), settled.moved
    found.damaged += settled.twice
    for sample in settled.samples:
        _count_deleted(sample, recording_of(bin_of(session), sample), found)
    for sample, recording in gone.items():
        _count_deleted(sample, recording, found)


def _count_deleted(sample: str, recording: str | None, found: Inventory) -> None:
    if recording is not None:
        for counts in (found.recorded, found.deleted):
            counts.setdefault(recording, Counter())[sample_camera(sample)] += 1


def _remove_temporary_files(session: Path, folder: Path, found: Inventory) -> None:
    for name in _names(folder):
        if is_temporary(name):
            _remove(session, folder / name, found)


def _remove_pictures_without_label(session: Path, found: Inventory) -> None:
    orphans: dict[str, list[Path]] = {}
    coloured: set[str] = set()
    for kind in PICTURES:
        for name in _names(session / kind):
            sample = sample_of_picture(kind, name)
            if sample is None:
                continue
            if sample in found.binned:
                continue
            if sample not in found.samples:
                orphans.setdefault(sample, []).append(session / kind / name)
            elif kind == "rgb":
                coloured.add(sample)
    found.damaged = sorted({*found.damaged, *(found.samples - coloured)})
    if len(orphans) > MOST_HALF_WRITTEN:
        found.orphans = len(orphans)
        return
    for paths in orphans.values():
        for path in paths:
            _remove(session, path, found)


def _remove(session: Path, path: Path, found: Inventory) -> None:
    path.unlink(missing_ok=True)
    found.removed.append(str(path.relative_to(session)))


def _count(session: Path, sample: str, found: Inventory) -> None:
    try:
        recording = read_recording(session / label_path(sample))
    except DatasetError:
        found.damaged.append(sample)
        return
    if recording is not None:
        found.recorded.setdefault(recording, Counter())[sample_camera(sample)] += 1


def _names(folder: Path) -> Iterator[str]:
    if folder.is_dir():
        yield from sorted(entry.name for entry in folder.iterdir() if entry.is_file())
