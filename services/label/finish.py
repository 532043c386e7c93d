"""The last steps for a frame that is kept: exact corners, poses, erasing. Runs in a worker process, niced.

The worker gets a job by value and the pixels by the slot of a sample ring, in which it erases in place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2

from common.config import Rig
from common.frames import SampleSlots
from common.labels import CameraLabel
from common.log import get
from common.markers import family
from common.messages import DetectedMarker
from common.service.crew import Crew, Failure
from common.service.memory import keep_freed_memory
from services.label.exact import ExactLabels, Finished, Options
from services.label.labelling import Around

_NICE = 10
_LIMIT_S = 30.0
"""No frame takes a hundredth of this: a worker that does hangs."""


@dataclass(frozen=True)
class Job:
    """A frame to finish; its pixels lie in ``slot`` of the sample ring ``ring``, ``around`` it is what is known."""

    key: str
    ring: str
    slot: int
    camera: CameraLabel
    markers: tuple[DetectedMarker, ...]
    around: Around
    depth_unit_mm: float | None = None


class Finisher:
    """The worker processes; one that dies or hangs is replaced, and only its own job is in danger.

    The workers get the rig by value: one that is replaced must not read a file that was edited meanwhile.
    """

    def __init__(self, rig: Rig) -> None:
        self._jobs: dict[str, Job] = {}
        self._crew = self._crew_for(rig)
        self._retired: list[Crew[Job, Finished]] = []
        self._deaths_before = 0

    @property
    def sockets(self) -> tuple[int, ...]:
        """For the Poller: readable when a job has ended."""
        return tuple(fd for crew in (self._crew, *self._retired) for fd in crew.sockets)

    @property
    def busy(self) -> int:
        """Jobs that are not finished."""
        return len(self._jobs)

    @property
    def restarts(self) -> int:
        """How many workers have died so far."""
        return self._deaths_before + sum(crew.replaced for crew in (self._crew, *self._retired))

    def submit(self, job: Job, *, first: bool = False) -> None:
        """Begin a job; ``first``: before all that wait."""
        self._jobs[job.key] = job
        self._crew.submit(job.key, job, first=first)

    def hurry(self, key: str) -> None:
        """Put a job that waits before the others, as if it had been ``first``."""
        for crew in (self._crew, *self._retired):
            crew.hurry(key)

    def finished(self) -> Iterator[tuple[Job, Finished | None]]:
        """Jobs that ended since the last call; None where the job failed (the reason is in the log)."""
        for crew in (self._crew, *self._retired):
            for key, result in crew.finished():
                if isinstance(result, Failure):
                    get().error("finish.failed", sample=key, fault=result.fault, what=result.what)
                yield self._jobs.pop(key), None if isinstance(result, Failure) else result
        for crew in [crew for crew in self._retired if not crew.busy]:
            self._deaths_before += crew.replaced
            self._retired.remove(crew)
            crew.close()

    def reload(self, rig: Rig) -> None:
        """Take over another rig; jobs under way end with the old one."""
        self._retired.append(self._crew)
        self._crew = self._crew_for(rig)

    def close(self) -> None:
        """End the workers; jobs that have not begun are dropped."""
        for crew in (self._crew, *self._retired):
            crew.close()

    def _crew_for(self, rig: Rig) -> Crew[Job, Finished]:
        return Crew(_finish, _prepare, (rig,), workers=rig.config.workers.finish, nice=_NICE, limit_s=_LIMIT_S)


class _Worker:
    """State of a worker process: how it labels, and the rings it has mapped."""

    def __init__(self, rig: Rig) -> None:
        config = rig.config
        options = Options(config.pose, config.inpaint, config.record)
        self.exact = ExactLabels(rig.boxes, family(config.markers.family, rig.folder), options)
        self.rings: dict[str, SampleSlots] = {}

    def slots(self, ring: str) -> SampleSlots:
        """The mapped ring. Of those whose owner has let go of them, nothing else would free the memory."""
        if ring not in self.rings:
            for name in [name for name, slots in self.rings.items() if slots.abandoned]:
                self.rings.pop(name).close()
            self.rings[ring] = SampleSlots(ring, writable=True)
        return self.rings[ring]


_worker: _Worker | None = None


def _prepare(rig: Rig) -> None:
    """Make this process a worker, which computes in one thread."""
    global _worker
    cv2.setNumThreads(1)
    keep_freed_memory()
    _worker = _Worker(rig)


def _finish(job: Job) -> Finished:
    assert _worker is not None
    pixels = _worker.slots(job.ring).view(job.slot)
    return _worker.exact.finish(pixels.bgr, pixels.depth, job.depth_unit_mm, job.camera, job.markers, job.around)
