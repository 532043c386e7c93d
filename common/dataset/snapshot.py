"""A session as it is at one moment, though a running stack goes on recording into it.

Nothing is asked of the stack and nothing is locked: a label is a sample's last file, so a sample whose label is there
is whole, and its files never change. All that can happen to them meanwhile is a move to the bin and back, so what is
not in the session is looked for in its bin (which is emptied only while no stack has the session open).
"""

from __future__ import annotations

from pathlib import Path

from common.dataset.bin import bin_of, labelled
from common.dataset.emptied import removed
from common.dataset.head import recording_of
from common.dataset.layout import RECORDS_FILE
from common.dataset.reader import SessionReader
from common.dataset.session import SessionFile
from common.errors import DatasetError
from common.labels import Label, StoredFile


class Snapshot(SessionReader):
    """The samples whose label was in the session's folder when this was made, and the account of just those.

    ``known``: every sample that the session ever had, with its recording, at least those that the account tells of.
    ``requests``: the lines of ``records.jsonl``.
    """

    def __init__(self, folder: Path) -> None:
        """Raises DatasetError for a session that can't be read, OSError."""
        super().__init__(folder)
        # The order counts: whatever the two accounts tell of is found afterwards, in one place or the other.
        self._samples = super().samples()
        path = folder / RECORDS_FILE
        self.requests: tuple[bytes, ...] = tuple(path.read_bytes().splitlines()) if path.exists() else ()
        self._file = super().session
        trash = bin_of(folder)
        there = set(self._samples).union(*(labelled(place) for place in (trash, folder, trash)))
        self.known: dict[str, str | None] = {
            sample: recording_of(folder, sample) or recording_of(trash, sample) for sample in sorted(there)
        } | removed(folder)

    @property
    def session(self) -> SessionFile:
        """``session.json`` as it was."""
        return self._file

    def samples(self) -> tuple[str, ...]:
        """The samples that there were, oldest first."""
        return self._samples

    def label(self, sample: str) -> Label:
        """A sample's label, though it was deleted since; raises DatasetError as `SessionReader.label`."""
        try:
            return super().label(sample)
        except DatasetError as error:
            if error.code != "missing_file" or (trash := self.bin) is None:
                raise
        try:
            return trash.label(sample)
        except DatasetError as error:
            if error.code != "missing_file":
                raise
        return super().label(sample)  # it was put back in between

    def path(self, file: StoredFile) -> Path:
        """Where a sample's file is now, in the session or its bin; raises DatasetError as `SessionReader.path`."""
        path = super().path(file)
        if not path.exists() and (trash := self.bin) is not None and (binned := trash.path(file)).exists():
            return binned
        return path
