"""Names and folders of a session: the only place that builds or takes apart a path inside a dataset.

::

    <root>/<session>/session.json, records.jsonl
                     rgb/rgb_<sample>.png            depth/depth_<sample>.png (uint16)
                     label/label_<sample>.json       original/original_<sample>.png (with keep_original)
                     bin/                            the same folders: samples that were deleted
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Literal

from common.ids import is_sample_name

PictureKind = Literal["rgb", "depth", "original"]

SESSION_FILE = "session.json"
RECORDS_FILE = "records.jsonl"
LABELS = "label"
PICTURES: tuple[PictureKind, ...] = ("rgb", "depth", "original")
FOLDERS: tuple[str, ...] = (*PICTURES, LABELS)
BIN = "bin"


def picture_path(kind: PictureKind, sample: str, extension: str = "png") -> PurePosixPath:
    """Where a new picture goes, relative to the session. Readers go by ``label.files`` instead."""
    return PurePosixPath(kind, f"{kind}_{sample}.{extension}")


def label_path(sample: str) -> PurePosixPath:
    """Where the label of a sample is, relative to the session."""
    return PurePosixPath(LABELS, f"{LABELS}_{sample}.json")


def sample_of_label(file_name: str) -> str | None:
    """The sample a label file's name belongs to, None for any other name."""
    return _sample_between(file_name, f"{LABELS}_", ".json")


def sample_of_picture(kind: PictureKind, file_name: str) -> str | None:
    """The sample a picture's file name belongs to, whatever its extension; None for any other name."""
    stem, dot, extension = file_name.rpartition(".")
    if not dot or not extension.isalnum():
        return None
    return _sample_between(stem, f"{kind}_", "")


def _sample_between(file_name: str, prefix: str, suffix: str) -> str | None:
    if not (file_name.startswith(prefix) and file_name.endswith(suffix)):
        return None
    sample = file_name[len(prefix) : len(file_name) - len(suffix)]
    return sample if is_sample_name(sample) else None
