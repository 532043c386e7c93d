"""What runs in a worker process: one sample from shared memory to the disk. Niced; gone with its parent."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path

import cv2

from common.dataset.faults import explain
from common.dataset.layout import LABELS, PictureKind
from common.dataset.locks import FolderLock
from common.errors import FrameLostError, RefusedError
from common.frames import SampleSlots
from common.labels import Label
from common.laps import Laps, Stopwatch
from common.messages import ErrorInfo
from common.service.memory import keep_freed_memory
from services.store.encode import LOSSLESS, Coding
from services.store.sample import is_stored, paths_of, pictures_for, write_sample

PIXELS_GONE = "pixels_gone"
NICE = 5
_MOST_RINGS = 16


@dataclass(frozen=True)
class WriteJob:
    """A sample to write into the session's folder: its label, where its pixels are, how its pictures are coded."""

    session: Path
    label: Label
    ring: str
    slot: int
    coding: Coding = LOSSLESS


@dataclass(frozen=True)
class Written:
    """What became of a job: ``bytes`` written (0 if the sample was on the disk already), or an ``error``.

    ``pictures``: by kind, the files written. ``laps``: what encoding, describing (checksums, the label's text) and
    writing with fsync took.
    """

    bytes: int = 0
    error: ErrorInfo | None = None
    pictures: dict[PictureKind, str] = field(default_factory=dict)
    laps: Laps = field(default_factory=dict)


@dataclass(frozen=True)
class Turn:
    """A job whose turn it is: leave ``reserve`` bytes free; the jobs still to come need the rings ``needed``."""

    job: WriteJob
    reserve: int
    delay_s: float
    needed: frozenset[str]


def prepare() -> None:
    """Make this process a worker, which computes in one thread."""
    cv2.setNumThreads(1)
    keep_freed_memory()


def write(turn: Turn) -> Written:
    """Write one sample; expected failures come back as ``error``."""
    job = turn.job
    if turn.delay_s:
        time.sleep(turn.delay_s)  # a slow disk, for tests (TAGMILL_STORE_DELAY_MS)
    try:
        with FolderLock(job.session / LABELS, shared=True):
            if is_stored(job.session, job.label.sample):
                return Written()
            pictures = pictures_for(job.label, _rings.slots(job.ring, turn.needed).view(job.slot))
            watch = Stopwatch()
            written = write_sample(job.session, job.label, pictures, turn.reserve, job.coding, watch)
            return Written(bytes=written, pictures=paths_of(job.label.sample, pictures, job.coding), laps=watch.laps)
    except FrameLostError as error:
        return Written(error=ErrorInfo(code=PIXELS_GONE, message=f"{job.label.sample} is lost: {error.message}"))
    except RefusedError as error:
        return Written(error=ErrorInfo(code=error.code, message=error.message))
    except OSError as error:
        return Written(error=explain(error, job.session))


class Rings:
    """The sample rings that this process has mapped; a ring's name is never used twice (it has a boot id)."""

    def __init__(self) -> None:
        self._mapped: OrderedDict[str, SampleSlots] = OrderedDict()

    @property
    def names(self) -> tuple[str, ...]:
        """The mapped ones, the one that was used longest ago first."""
        return tuple(self._mapped)

    def slots(self, ring: str, needed: Container[str]) -> SampleSlots:
        """The mapped ring; raises FrameLostError if it is gone.

        A new one takes the place of those that are gone, whose memory nobody else holds any more: unless a job
        that is still to come names them (``needed``).
        """
        if ring not in self._mapped:
            for name in [name for name, slots in self._mapped.items() if slots.abandoned and name not in needed]:
                self._mapped.pop(name).close()
            self._mapped[ring] = SampleSlots(ring)
            while len(self._mapped) > _MOST_RINGS:
                self._mapped.popitem(last=False)[1].close()
        self._mapped.move_to_end(ring)
        return self._mapped[ring]

    def close(self) -> None:
        """Unmap all."""
        while self._mapped:
            self._mapped.popitem()[1].close()


_rings = Rings()
