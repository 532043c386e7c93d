"""When a camera's frames were captured: how evenly, and whether one was left out. From what capture announces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.messages import CameraState, FrameRef

_ENDS_S = 1.0
"""How much of either end says where the camera's schedule lay."""

_WITHOUT_FRAME = {"timeout", "stalled", "frozen", "reconnect"}
"""What a camera counts when no frame came; how many that were is seen by its schedule."""


@dataclass(frozen=True)
class Jitter:
    """How far the times between frames that follow each other are from the camera's period, ms, either way."""

    intervals: int
    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True)
class Captured:
    """The frames of a camera between the first and the last one heard of.

    ``offered``: how many its schedule had in that time. ``dropped``: those that it gave and capture had no place for
    in time, and what the driver itself says it lost, by reason. ``unheard``: captured, but the news of it didn't come.
    """

    offered: int
    captured: int
    dropped: dict[str, int]
    unheard: int


class CaptureTimes:
    """The frames of one camera that gives ``fps`` frames a second by the host's clock (the synthetic one does)."""

    def __init__(self, fps: float) -> None:
        self._period_ns = 1e9 / fps
        self._at_ends = max(round(_ENDS_S * fps), 1)
        self._counts: list[int] = []
        self._taken_ns: list[int] = []
        self._lost_before: dict[str, int] | None = None
        self._lost: dict[str, int] = {}

    def announced(self, ref: FrameRef) -> None:
        """A frame; what comes out of turn (a capture process that began anew) is not of this stream."""
        if not ref.preview and (not self._counts or ref.count > self._counts[-1]):
            self._counts.append(ref.count)
            self._taken_ns.append(ref.captured_mono_ns)

    def told(self, state: CameraState) -> None:
        """What the camera says of its losses."""
        self._lost = dict(state.lost)
        if self._lost_before is None:
            self._lost_before = self._lost

    def captured(self) -> Captured:
        """The account of all of them.

        The synthetic camera gives its frames at fixed times and waits for nobody; who fetches one later than a period
        finds the schedule moved by so much. A fetched frame is never early, so the least lateness of a second shows
        where the schedule lies, and its move between the ends, in periods, is the number of frames that were lost.
        """
        counts = np.array(self._counts, dtype=np.int64)
        if not len(counts):
            return Captured(0, 0, {}, 0)
        captured = int(counts[-1] - counts[0]) + 1
        late = np.array(self._taken_ns) - self._taken_ns[0] - (counts - counts[0]) * self._period_ns
        moved = float(late[-self._at_ends :].min() - late[: self._at_ends].min())
        missed = max(round(moved / self._period_ns), 0)
        before = self._lost_before or {}
        dropped = {why: count - before.get(why, 0) for why, count in self._lost.items() if why not in _WITHOUT_FRAME}
        dropped["late"] = missed
        told = {why: count for why, count in dropped.items() if count > 0}
        return Captured(captured + missed, captured, told, captured - len(counts))

    def jitter(self, since_ns: int, until_ns: int) -> Jitter:
        """Of the frames captured in that time (monotonic ns)."""
        off = self._deviations_ms(since_ns, until_ns)
        if not len(off):
            return Jitter(0, float("nan"), float("nan"), float("nan"))
        p50, p99 = np.percentile(off, (50, 99))
        return Jitter(len(off), round(float(p50), 3), round(float(p99), 3), round(float(off.max()), 3))

    def _deviations_ms(self, since_ns: int, until_ns: int) -> NDArray[np.float64]:
        taken, counts = np.array(self._taken_ns, dtype=np.int64), np.array(self._counts, dtype=np.int64)
        inside = (taken >= since_ns) & (taken <= until_ns)
        taken, counts = taken[inside], counts[inside]
        neighbours = np.diff(counts) == 1
        return np.asarray(np.abs(np.diff(taken)[neighbours] - self._period_ns) / 1e6, dtype=np.float64)
