"""``records.jsonl``: a line for each camera of a single request (`record`), so that ``session.json`` stays small.

Only the disk thread may use it once the session is open.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from itertools import accumulate
from pathlib import Path

from pydantic import ValidationError

from common.dataset import RECORDS_FILE, append_bytes
from common.errors import DatasetError
from common.ledgers import CameraLedger, Ledger


class Records:
    """The requests of a session that are over. In memory is where each line begins, not what it says.

    ``totals``: the sums of all lines by camera, as they were at the opening.
    """

    def __init__(self, session: Path) -> None:
        """Read the file, and drop a last line that a kill cut off; raises DatasetError, OSError."""
        self._path = session / RECORDS_FILE
        self._places: dict[str, dict[str, int]] = {}
        self.totals: dict[str, CameraLedger] = {}
        if self._path.exists():
            self._read()

    def __contains__(self, recording: str) -> bool:
        return recording in self._places

    def append(self, entries: Iterable[Ledger]) -> list[Ledger]:
        """Write entries durably, one fsync for all; returns those that are new. Raises OSError, then none is kept.

        A camera's entry of a recording is written once, however often it comes.
        """
        new = [
            entry for entry in entries if not self._places.get(entry.spec.recording, {}).keys() >= set(entry.cameras)
        ]
        if not new:
            return []
        lines = [entry.model_dump_json().encode() + b"\n" for entry in new]
        begin = append_bytes(self._path, b"".join(lines))
        places = accumulate((len(line) for line in lines[:-1]), initial=begin)
        for entry, place in zip(new, places, strict=True):
            self._enter(entry, place)
        return new

    def find(self, recording: str) -> Ledger | None:
        """A request's ledger with all its cameras; None for an unknown one. Raises OSError, DatasetError."""
        places = self._places.get(recording)
        if places is None:
            return None
        with self._path.open("rb") as file:
            parts = []
            for place in sorted(set(places.values())):
                file.seek(place)
                parts.append(self._parse(file.readline(), f"byte {place}"))
        cameras = {camera: account for part in parts for camera, account in part.cameras.items()}
        return parts[-1].model_copy(update={"cameras": cameras})

    def _read(self) -> None:
        place = 0
        with self._path.open("r+b") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(b"\n"):
                    file.truncate(place)
                    os.fsync(file.fileno())
                    return
                entry = self._parse(line, f"line {number}")
                self._enter(entry, place)
                self.totals = summed(self.totals, entry)
                place += len(line)

    def _parse(self, line: bytes, where: str) -> Ledger:
        try:
            return Ledger.model_validate_json(line)
        except ValidationError as error:
            raise DatasetError(f"{self._path}, {where}: not the ledger of a request; it is damaged: {error}") from error

    def _enter(self, entry: Ledger, place: int) -> None:
        self._places.setdefault(entry.spec.recording, {}).update(dict.fromkeys(entry.cameras, place))


def summed(totals: dict[str, CameraLedger], entry: Ledger) -> dict[str, CameraLedger]:
    """The totals with one more request."""
    return {**totals, **{camera: _sum(totals.get(camera), account) for camera, account in entry.cameras.items()}}


def _sum(one: CameraLedger | None, other: CameraLedger) -> CameraLedger:
    one = one or CameraLedger()
    return CameraLedger(
        captured=one.captured + other.captured,
        detected=dict(Counter(one.detected) + Counter(other.detected)),
        labelled=one.labelled + other.labelled,
        recorded=one.recorded + other.recorded,
        refused=dict(Counter(one.refused) + Counter(other.refused)),
        dropped=dict(Counter(one.dropped) + Counter(other.dropped)),
        pending=one.pending + other.pending,
    )
