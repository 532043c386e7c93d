"""What became of this camera's process the last time: a driver that kills its process must not do so unseen.

A vendor's library may crash the process that opens a camera. The dying process can't say so and the supervisor just
starts the next one, so each life leaves a note in the run folder: what it is doing with which driver, below it
(written by ``faulthandler`` in the moment of the crash) the signal and the Python line. A clean end removes the note;
a life that finds one tells it, waits like after any other loss, and only then opens the camera again.
"""

from __future__ import annotations

import faulthandler
import json
import re
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import CameraError
from services.capture.cameras.base import Camera

SUFFIX = ".life"
STALE_S = 120.0
"""An older note is of another run of the stack: nothing that this one has to wait for."""

_OPENING, _OPEN, _CLOSED = "opening", "open", "closed"
_SIGNALS = {
    "Segmentation fault": "SIGSEGV",
    "Bus error": "SIGBUS",
    "Illegal instruction": "SIGILL",
    "Floating-point exception": "SIGFPE",
    "Aborted": "SIGABRT",
}
_FAULT = re.compile(r"^Fatal Python error: (.+)$", re.MULTILINE)
_FRAME = re.compile(r'^  File "(.+)", line (\d+) in (.+)$', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Death:
    """How the process before this one died. ``at``: the Python line, empty if unknown; ``count``: times in a row."""

    signal: str
    opening: bool
    at: str
    count: int

    def sentence(self, camera: str, driver: str) -> str:
        """For the operator."""
        doing = "while opening the camera" if self.opening else "while the camera was open"
        place = f" at {self.at}" if self.at else ""
        often = f", {self.count} times in a row" if self.count > 1 else ""
        return (
            f"{camera}: the process died by {self.signal} {doing} ({driver}){place}{often}: the driver's library "
            "crashed or the process was killed; check the camera's cable, power and permissions; it is tried again"
        )


class LastLife:
    """The note of one camera's process. ``path`` is the same for all its lives; one at a time holds the name."""

    def __init__(self, path: Path, camera: str, driver: str, log: FilteringBoundLogger) -> None:
        self._path = path
        self._camera = camera
        self._driver = driver
        self._log = log
        self._file: BinaryIO | None = None
        self.died = _read(path)
        self._untold = self.died is not None
        self._deaths = self.died.count if self.died else 0
        if self.died is not None:
            at, count = self.died.at, self.died.count
            log.error("camera.process_died", signal=self.died.signal, opening=self.died.opening, at=at, count=count)

    def guard(self, open_camera: Callable[[], Camera]) -> Callable[[], Camera]:
        """``open_camera`` under watch. Its first call tells of a death before this life, as a CameraError."""

        def guarded() -> Camera:
            if self.died is not None and self._untold:
                self._untold = False
                raise CameraError(self.died.sentence(self._camera, self._driver))
            self._note(_OPENING)
            try:
                with _no_core():
                    camera = open_camera()
            except BaseException:
                self._note(_CLOSED)
                raise
            self._deaths = 0
            self._note(_OPEN)
            return camera

        return guarded

    def end(self) -> None:
        """A clean end: remove the note; idempotent."""
        if self._file is not None:
            faulthandler.disable()
            self._file.close()
            self._file = None
        self._path.unlink(missing_ok=True)

    def _note(self, doing: str) -> None:
        """Write what this life is doing; a crash is written below it. A full disk costs the note, not the camera."""
        try:
            if self._file is None:
                self._file = self._path.open("wb", buffering=0)
            self._file.seek(0)
            self._file.truncate()
            self._file.write(json.dumps({"doing": doing, "deaths": self._deaths}).encode() + b"\n")
            faulthandler.enable(self._file, all_threads=False)
        except OSError as error:
            self._log.warning("camera.no_note", path=str(self._path), why=error.strerror)


def _read(path: Path) -> Death | None:
    """The death that a note tells of; None without a note, for an old one, or one that tells of nothing to fear."""
    try:
        age_s = clock.wall_ns() / 1e9 - path.stat().st_mtime
        head, _, words = path.read_text(errors="replace").partition("\n")
    except FileNotFoundError:
        return None
    try:
        note = json.loads(head)
        opening, deaths = note["doing"] == _OPENING, int(note["deaths"])
    except (ValueError, KeyError, TypeError):
        return None  # cut off while it was written: nothing was opened yet
    fault = _FAULT.search(words)
    if age_s > STALE_S or (fault is None and not opening):
        return None  # whoever kills a process in its normal course knows that
    frame = _FRAME.search(words)
    at = f"{Path(frame[1]).name}:{frame[2]} in {frame[3]}" if frame else ""
    name = _SIGNALS.get(fault[1], fault[1]) if fault else "SIGKILL"
    return Death(name, opening, at, deaths + 1)


@contextmanager
def _no_core() -> Iterator[None]:
    """No core file of a crash in here: the next try may crash as well, and the next."""
    soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CORE, (soft, hard))
