"""Does every file open, and is it what its label says? And what lies in the session without a label?"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.bounded import TooLargeError, read_bytes
from common.dataset import FOLDERS, LABELS, PICTURES, PictureKind, SessionReader, is_temporary, label_path
from common.dataset.bin import bin_of, names_in
from common.dataset.emptied import removed
from common.dataset.layout import sample_of_label, sample_of_picture
from common.errors import DatasetError
from common.labels import Label, StoredFile
from common.ledgers import Ledger
from common.pictures import MOST_BYTES, decode
from tools.inspect.facts import Problem, ProblemKind

_DEPTH_AXES = 2


@dataclass
class Opened:
    """A sample as far as it could be opened; pictures that are broken are missing here."""

    label: Label | None = None
    pictures: dict[PictureKind, NDArray[np.generic]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    bytes: int = 0


def open_sample(reader: SessionReader, sample: str) -> Opened:
    """Read everything of a sample and compare it with its label: existence, size, checksum, picture size and type."""
    opened = Opened()
    path = str(label_path(sample))
    try:
        label = reader.label(sample)
    except DatasetError as error:
        opened.problems.append(Problem("label", sample, path, error.message))
        return opened
    wrong = _of_label(label, sample)
    if wrong is not None or label.files is None:
        opened.problems.append(Problem("label", sample, path, wrong or f"the label of {sample} names no files"))
        return opened
    opened.label = label
    if (label.depth is None) != (label.files.depth is None):
        opened.problems.append(Problem("label", sample, path, f"the label of {sample} tells of depth and names none"))
    for kind in PICTURES:
        file: StoredFile | None = getattr(label.files, kind)
        if file is not None:
            _open_picture(reader, label, kind, file, opened)
    return opened


def _of_label(label: Label, sample: str) -> str | None:
    if label.sample != sample:
        return f"the label of {sample} says that it is of {label.sample}"
    return None


def _open_picture(reader: SessionReader, label: Label, kind: PictureKind, file: StoredFile, opened: Opened) -> None:
    def note(problem: ProblemKind, message: str) -> None:
        opened.problems.append(Problem(problem, label.sample, file.path, message))

    try:
        data = read_bytes(reader.path(file), MOST_BYTES)
    except FileNotFoundError:
        return note("missing_file", f"{file.path} is missing")
    except (OSError, TooLargeError) as error:
        return note("damaged", f"{file.path} can't be read: {getattr(error, 'strerror', None) or error}")
    except DatasetError as error:
        return note("label", error.message)
    opened.bytes += len(data)
    if len(data) != file.size:
        note("damaged", f"{file.path} has {len(data)} bytes, its label says {file.size}")
    elif hashlib.sha256(data).hexdigest() != file.sha256:
        note("damaged", f"{file.path} was changed: its checksum is not the one in its label")
    picture = decode(data, cv2.IMREAD_UNCHANGED if kind == "depth" else cv2.IMREAD_COLOR)
    if picture is None:
        return note("damaged", f"{file.path} is no picture that can be read")
    size, expected = picture.shape[:2], (label.camera.height, label.camera.width)
    if size != expected:
        return note("wrong_size", f"{file.path} is {size[1]}x{size[0]}, its label says {expected[1]}x{expected[0]}")
    if kind == "depth" and (picture.dtype != np.uint16 or picture.ndim != _DEPTH_AXES):
        return note("wrong_size", f"{file.path} is {picture.dtype} with {picture.ndim} axes, not 16 bit depth")
    opened.pictures[kind] = picture
    return None


def stray_files(folder: Path) -> list[Problem]:
    """Pictures without a label, and files that a kill left half-written; raises OSError."""
    there = {sample for name in names_in(folder / LABELS) if (sample := sample_of_label(name)) is not None}
    found = []
    for place in FOLDERS:
        for name in sorted(names_in(folder / place)):
            path = f"{place}/{name}"
            if is_temporary(name):
                found.append(Problem("temporary", None, path, f"{path} was left half-written"))
                continue
            sample = next((sample_of_picture(kind, name) for kind in PICTURES if kind == place), None)
            if sample is not None and sample not in there:
                found.append(Problem("orphan", None, path, f"{path} has no label"))
    return found


def ledger_problems(reader: SessionReader, recorded: dict[str, int]) -> Iterator[Problem]:
    """Whether ``session.json`` opens and its ledger adds up; ``recorded``: labels in the session by recording."""
    name = "session.json"
    try:
        session = reader.session
    except DatasetError as error:
        yield Problem("session", None, name, error.message)
        return
    for recording, ledger in session.recordings.items():
        yield from _unsettled(recording, ledger, name)
    gone = _labels_by_recording(reader)
    for recording in recorded.keys() & session.recordings.keys():
        told = sum(account.recorded for account in session.recordings[recording].cameras.values())
        found = recorded[recording] + gone.get(recording, 0)
        if found > told and session.recordings[recording].phase in ("ended", "interrupted"):
            yield Problem("ledger", None, name, f"{recording}: {found} samples name it, its ledger says {told}")
        elif found < told and session.recordings[recording].phase in ("ended", "interrupted"):
            yield Problem("ledger", None, name, f"{recording}: {told} were recorded, {told - found} are not there")


def _unsettled(recording: str, ledger: Ledger, path: str) -> Iterator[Problem]:
    if ledger.phase not in ("ended", "interrupted"):
        return
    for camera, account in ledger.cameras.items():
        if not account.settled:
            ends = account.recorded + sum(account.refused.values()) + sum(account.dropped.values())
            text = f"{recording}, {camera}: {account.captured} captured, {ends} accounted for"
            yield Problem("ledger", None, path, text)


def _labels_by_recording(reader: SessionReader) -> dict[str, int]:
    """Samples in the bin, and those that were removed from it for good, by recording."""
    counts: dict[str, int] = {}
    names = removed(reader.folder)
    for recording in names.values():
        if recording is not None:
            counts[recording] = counts.get(recording, 0) + 1
    if reader.bin is None:
        return counts
    from common.dataset.head import recording_of

    for sample in reader.bin.samples():
        if sample not in names:
            recording = recording_of(bin_of(reader.folder), sample)
            if recording is not None:
                counts[recording] = counts.get(recording, 0) + 1
    return counts
