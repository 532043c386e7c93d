"""A guided calibration that another program shows (the console): what happens out, orders in, as lines."""

from __future__ import annotations

import json
import os
import select
import sys
from typing import Any

from common.calibration import Guidance

_CHUNK = 4096


class Events:
    """JSON lines with a key ``event`` on stdout (the result follows without one), orders as words on stdin.

    The end of stdin is the order ``end``: who no longer gives orders doesn't look any more either.
    """

    def __init__(self) -> None:
        self._ear = sys.stdin.fileno()
        self._begun = b""
        self._ended = False

    def show(self, told: Guidance) -> None:
        """What the guide said."""
        self._say("guidance", told.document())

    def progress(self, done: int, total: int) -> None:
        """How far the comparison of lens models is."""
        self._say("progress", {"done": done, "total": total})

    def orders(self) -> list[str]:
        """What came since the last call; doesn't wait."""
        while not self._ended and select.select([self._ear], [], [], 0.0)[0]:
            chunk = os.read(self._ear, _CHUNK)
            self._ended = not chunk
            self._begun += chunk
        *lines, self._begun = self._begun.split(b"\n")
        found = [line.decode(errors="replace").strip() for line in lines]
        return [*found, "end"] if self._ended else found

    @staticmethod
    def _say(event: str, document: dict[str, Any]) -> None:
        print(json.dumps({"event": event} | document), flush=True)
