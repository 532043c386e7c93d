"""When a frame was taken, on the host's clock: one mapping for all drivers.

A frame arrives some while after it was taken, sooner or later as the bus, the driver and the scheduler please. The
camera's own clock doesn't know that jitter, but it has another origin and runs a little faster or slower.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from services.capture.cameras.base import Stamps

BUCKET_NS = 1_000_000_000
BUCKETS = 30
"""The mapping follows from the last half minute."""
DRIFT_FROM_BUCKETS = 5
MAX_DRIFT = 500e-6
"""Quartzes differ by less than 100 ppm; a steeper line is a line through noise."""
JUMP_NS = 1_000_000_000
"""A frame this far off the mapping is one of a clock that was set anew (or of a process that was stopped)."""

Point = tuple[int, int]
"""Device time and arrival minus device time, ns."""


class DeviceClock:
    """Maps a camera's clock to the host's monotonic one.

    arrival - device = offset + delay, where the delay is never less than its least, and often near it. So the offset
    (with the least delay in it) is the lower bound of what is seen in a sliding window, and the drift its slope: the
    line below all points that is nearest to them, an edge of their lower convex hull (S. Moon, P. Skelly, D. Towsley,
    "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999, section IV). The hull is of
    the least points of each second; before there are five of them, the least is taken and no drift.
    """

    def __init__(self) -> None:
        self._least: deque[Point] = deque(maxlen=BUCKETS)
        self._open: Point | None = None
        self._line = (0, 0, 0.0)
        self._newest_ns = 0

    @property
    def drift(self) -> float:
        """By how much the host's clock runs faster than the device's (1e-6 is one microsecond a second)."""
        return self._line[2]

    def host_ns(self, device_ns: int, arrived_ns: int) -> int:
        """When the frame of ``device_ns``, which came at ``arrived_ns`` (host), was taken (host, monotonic ns).

        Too late by the least delay, which can't be seen from here; never after its arrival.
        """
        seen = arrived_ns - device_ns
        if self._open is not None and (device_ns < self._newest_ns or abs(seen - self._offset(device_ns)) > JUMP_NS):
            self._least.clear()
            self._open = None
        self._newest_ns = device_ns
        self._take((device_ns, seen))
        return device_ns + self._offset(device_ns)

    def _take(self, point: Point) -> None:
        if self._open is None:
            self._open = point
            self._fit()
            return
        if point[0] // BUCKET_NS != self._open[0] // BUCKET_NS:
            self._least.append(self._open)
            self._open = point
            self._fit()
        elif point[1] < self._open[1]:
            self._open = point

    def _offset(self, device_ns: int) -> int:
        """The line at this time, and never above what this second has shown."""
        assert self._open is not None
        if not self._least:
            return self._open[1]
        at, offset, slope = self._line
        return min(offset + int(slope * (device_ns - at)), self._open[1] + int(slope * (device_ns - self._open[0])))

    def _fit(self) -> None:
        points = list(self._least)
        if not points:
            return
        at, least = min(points, key=lambda point: point[1])
        self._line = (at, least, 0.0)
        if len(points) < DRIFT_FROM_BUCKETS:
            return
        middle = sum(at for at, _ in points) / len(points)
        hull = _lower_hull(points)
        left, right = next(pair for pair in pairwise(hull) if pair[0][0] <= middle <= pair[1][0])
        slope = (right[1] - left[1]) / (right[0] - left[0])
        if abs(slope) <= MAX_DRIFT:
            self._line = (left[0], left[1], slope)


def _lower_hull(points: list[Point]) -> list[Point]:
    """Of points in the order of their times."""
    hull: list[Point] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2], hull[-1]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


class Stamper:
    """Host stamps (monotonic ns) of one opened camera's frames; they never run backwards and are never of the future.

    ``how``: see ``Description.stamps``.
    """

    def __init__(self) -> None:
        self._clock = DeviceClock()
        self._newest_ns = 0

    def stamp(self, how: Stamps, device_ns: int | None, arrived_ns: int) -> int:
        """When the frame was taken, as well as that can be known."""
        taken = arrived_ns
        if device_ns is not None and how == "device":
            taken = self._clock.host_ns(device_ns, arrived_ns)
        elif device_ns is not None and how == "monotonic" and 0 <= arrived_ns - device_ns < JUMP_NS:
            taken = device_ns
        self._newest_ns = min(max(taken, self._newest_ns + 1), arrived_ns)
        return self._newest_ns
