"""Samples that wait for the frames after them: an object was seen just before, but not in the frame itself.

Its pixels are kept in the sample's slot already. As soon as all its objects were seen again, or can't be in time any
more, the job goes to a worker with what is known by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from services.label.finish import Job
from services.label.labelling import Around
from services.label.sightings import GAP_NS, Expected

LONGEST_NS = GAP_NS + 300_000_000
"""Nothing waits longer (wall clock): what follows within the gap has been labelled by then."""

LookAround = Callable[[str, int], Around]
"""What is known by now around a moment of a camera."""


@dataclass(frozen=True)
class Wait:
    """What a sample waits for: ``objects`` to be seen after ``moment_ns`` of its camera, until ``until_ns``."""

    camera: str
    moment_ns: int
    objects: frozenset[str]
    until_ns: int


class Held:
    """The waiting samples' jobs, in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Job, Wait]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, job: Job, wait: Wait) -> None:
        """Keep a job until its objects were seen again."""
        self._waiting.append((job, wait))

    def due(self, look: LookAround, newest: Callable[[str], int], now_ns: int, *, all_: bool = False) -> Iterator[Job]:
        """Jobs that need wait no longer, with what is known around them now.

        ``newest`` gives the moment of a camera's newest labelled frame.
        """
        for item in list(self._waiting):
            job, wait = item
            around = look(wait.camera, wait.moment_ns)
            waiting = [known for known in around.expected if known.name in wait.objects]
            hopeful = any(_may_come(known, newest(wait.camera)) for known in waiting)
            if all_ or now_ns >= wait.until_ns or not hopeful:
                self._waiting.remove(item)
                yield Job(job.key, job.ring, job.slot, job.camera, job.markers, around, job.depth_unit_mm)


def worth_waiting(around: Around, missing: frozenset[str], newest_ns: int) -> frozenset[str]:
    """The missing objects that may still be interpolated once they are seen again."""
    return frozenset(item.name for item in around.expected if item.name in missing and _may_come(item, newest_ns))


def _may_come(item: Expected, newest_ns: int) -> bool:
    return item.after is None and newest_ns - item.before.time_ns < GAP_NS
