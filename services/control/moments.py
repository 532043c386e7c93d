"""Which frames of several cameras were taken at the same moment, as nearly as can be. Pure.

Control hears of every labelled frame when it was taken and what is in it; the pixels stay where they are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from common import ids
from common.labels import PairLabel
from common.messages import Labels

REMEMBERED = 32
"""Frames of a camera; more than a ring holds."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A labelled frame: when it was taken (ns on both clocks) and what its quick label says."""

    camera: str
    boot: str
    frame: int
    mono_ns: int
    wall_ns: int
    objects: int
    missing: bool
    ambiguous: bool

    @property
    def sample(self) -> str:
        """The name of its sample, if it is stored."""
        return ids.sample_name(self.wall_ns, self.camera, self.frame)


@dataclass(frozen=True, slots=True)
class Chosen:
    """One frame of each camera: the ``reference`` camera's, and those nearest to it in time."""

    reference: str
    moments: Mapping[str, Moment]

    @property
    def at_ns(self) -> int:
        """When the reference frame was taken."""
        return self.moments[self.reference].mono_ns

    def pair_of(self, camera: str) -> PairLabel:
        """What the label of this camera's frame says of the others."""
        offset_ns = self.moments[camera].mono_ns - self.at_ns
        return PairLabel(
            reference=self.reference,
            offset_ms=offset_ns / 1e6,
            spread_ms=spread_ms(self.moments.values()),
            samples={name: moment.sample for name, moment in sorted(self.moments.items())},
        )


Fits = Callable[[Moment], bool]


class Moments:
    """The newest labelled frames of each camera."""

    def __init__(self) -> None:
        self._seen: dict[str, deque[Moment]] = {}

    def hear(self, labels: Labels) -> None:
        """A frame was labelled. A camera in a new life begins anew."""
        ref = labels.ref
        seen = self._seen.setdefault(ref.camera, deque(maxlen=REMEMBERED))
        if seen and (seen[-1].boot != ref.boot or seen[-1].frame >= ref.frame):
            seen.clear()
        seen.append(
            Moment(
                ref.camera,
                ref.boot,
                ref.frame,
                ref.captured_mono_ns,
                ref.captured_wall_ns,
                len(labels.objects),
                bool(labels.missing),
                any(item.quality.ambiguous for item in labels.objects),
            )
        )

    def recent(self, cameras: Sequence[str], since_ns: int) -> tuple[str, ...]:
        """The cameras of which a frame taken after ``since_ns`` was labelled."""
        return self.fitting(cameras, since_ns, lambda _: True)

    def fitting(self, cameras: Sequence[str], since_ns: int, fits: Fits) -> tuple[str, ...]:
        """The cameras of which a frame taken after ``since_ns`` fits."""
        return tuple(
            name
            for name in cameras
            if any(item.mono_ns >= since_ns and fits(item) for item in self._seen.get(name, ()))
        )

    def chosen(self, cameras: Sequence[str], since_ns: int, fits: Fits) -> Chosen | None:
        """The first frames after ``since_ns`` that were taken together and all fit; None while there are none.

        The slowest camera is the reference. Of each other one it is the frame nearest in time to the reference's,
        which is sure as soon as one was taken after it; so the spread is at most half the interval of the second
        slowest on either side.
        """
        seen = {name: self._seen.get(name) or deque() for name in cameras}
        if not all(seen.values()):
            return None
        reference = max(cameras, key=lambda name: (self._interval_ns(name), name))
        for moment in seen[reference]:
            if moment.mono_ns < since_ns or not fits(moment):
                continue
            if any(frames[-1].mono_ns < moment.mono_ns for frames in seen.values()):
                return None  # a nearer one may still come
            nearest = {
                name: min(frames, key=lambda item: abs(item.mono_ns - moment.mono_ns)) for name, frames in seen.items()
            }
            if all(item.mono_ns >= since_ns and fits(item) for item in nearest.values()):
                return Chosen(reference, nearest)
        return None

    def _interval_ns(self, camera: str) -> float:
        times = [item.mono_ns for item in self._seen[camera]]
        steps = [after - before for before, after in pairwise(times)]
        return median(steps) if steps else float("inf")


def spread_ms(moments: Iterable[Moment]) -> float:
    """From the first to the last of several frames."""
    times = [moment.mono_ns for moment in moments]
    return (max(times) - min(times)) / 1e6
