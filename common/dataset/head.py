"""Which recording a label belongs to, from its first lines: the rest of a session's labels needn't be read for it."""

from __future__ import annotations

import re
from pathlib import Path

from common.dataset.layout import label_path
from common.dataset.session import parse_versioned, read_text
from common.errors import DatasetError
from common.labels import Label

_HEAD_BYTES = 1024
_RECORDING = re.compile(rb'^ *"recording": *(?:null|"([^"\\\x80-\xff]*)"),?$', re.MULTILINE)
"""A name has ASCII letters only; whatever else stands there is read, or refused, with the whole label."""


def read_recording(path: Path) -> str | None:
    """The recording a label file names; raises OSError, DatasetError if it is damaged."""
    with path.open("rb") as file:
        match = _RECORDING.search(file.read(_HEAD_BYTES))
    if match is None:
        return parse_versioned(Label, read_text(path), path).recording
    return match.group(1).decode("ascii") if match.group(1) else None


def recording_of(folder: Path, sample: str) -> str | None:
    """The recording of a sample in a session's folder, or a bin's; None too if its label can't be read."""
    try:
        return read_recording(folder / label_path(sample))
    except (OSError, DatasetError):
        return None
