"""Counts a stack's frames from what it says on the bus."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from common import clock
from common.bus import Poller, Subscriber
from common.messages import CameraState, Detections, FrameAnnounced, Labels, Message, ServiceState
from tools.bench.load_hops import FrameHops, Hop


@dataclass
class CameraLoad:
    """One camera over the measured time. Frames; latency in ms from capture to published label."""

    offered: int = 0
    captured: int = 0
    detected: int = 0
    labelled: int = 0
    skipped: dict[str, int] = field(default_factory=dict)
    ring_overruns: int = 0
    latency_p50_ms: float | None = None
    latency_p99_ms: float | None = None


@dataclass
class _Seen:
    """What was heard of one camera: its first and last frame numbers by count, with their capture times."""

    first: tuple[int, int] | None = None
    last: tuple[int, int] | None = None
    detected: int = 0
    labelled: int = 0
    late_ms: list[float] = field(default_factory=list)
    skips_before: dict[str, int] | None = None
    skips: dict[str, int] = field(default_factory=dict)


class LoadCounter:
    """Listens for a time; ``reset`` forgets the warm-up.

    A camera's captured frames are counted by the number of its newest frame, so frames that nobody looked at
    count as well. Offered = the nominal rate over the time between the first and the last capture heard of.
    """

    def __init__(self, subscriber: Subscriber, fps: float) -> None:
        self._subscriber = subscriber
        self._fps = fps
        self._poller = Poller(subscriber)
        self.reset()

    def reset(self) -> None:
        """Begin to count from here."""
        self._cameras: dict[str, _Seen] = {}
        self._hops = FrameHops()
        self._dropped: dict[str, Counter[str]] = {}
        self._began_ns = clock.monotonic_ns()
        self.seconds = 0.0

    def listen(self, seconds: float) -> None:
        """Count for this long."""
        end = clock.monotonic_ns() + int(seconds * 1e9)
        while (left := end - clock.monotonic_ns()) > 0:
            self._poller.wait(min(left / 1e9, 0.2))
            for received in self._subscriber.receive():
                self._hear(received.message, received.stamp.mono_ns)
        self.seconds = (clock.monotonic_ns() - self._began_ns) / 1e9

    def _hear(self, message: Message, sent_ns: int) -> None:
        match message:
            case FrameAnnounced(ref=ref):
                self._hops.announced(ref, sent_ns)
                if not ref.preview:
                    _extend(self._cameras.setdefault(ref.camera, _Seen()), ref.count, sent_ns)
            case CameraState():
                seen = self._cameras.setdefault(message.camera.name, _Seen())
                _extend(seen, message.captured, sent_ns)
            case Detections():
                seen = self._cameras.setdefault(message.ref.camera, _Seen())
                seen.detected += 1
                self._hops.detected(message.ref, sent_ns, message.took_ns)
                seen.skips = dict(message.skipped)
                if seen.skips_before is None:
                    seen.skips_before = dict(message.skipped)
            case Labels():
                seen = self._cameras.setdefault(message.ref.camera, _Seen())
                seen.labelled += 1
                self._hops.labelled(message.ref, sent_ns, message.took_ns)
                seen.late_ms.append((sent_ns - message.ref.captured_mono_ns) / 1e6)
            case ServiceState():
                self._dropped[message.service] = Counter(message.dropped)

    def result(self) -> dict[str, CameraLoad]:
        """The cameras' figures."""
        return {name: self._camera(seen) for name, seen in sorted(self._cameras.items())}

    def hops(self) -> dict[str, Hop]:
        """Where the frames of all cameras spent their time."""
        return self._hops.result()

    def _camera(self, seen: _Seen) -> CameraLoad:
        load = CameraLoad(detected=seen.detected, labelled=seen.labelled)
        if seen.first is not None and seen.last is not None:
            load.captured = seen.last[0] - seen.first[0]
            load.offered = round(self._fps * (seen.last[1] - seen.first[1]) / 1e9)
        before = seen.skips_before or {}
        skips = {f"detect: {why}": count - before.get(why, 0) for why, count in seen.skips.items()}
        load.skipped = {where: count for where, count in skips.items() if count}
        load.ring_overruns = skips.get("detect: frame_lost", 0)
        behind = seen.detected - seen.labelled
        if behind > 1:
            load.skipped["label: superseded"] = behind
        if seen.late_ms:
            load.latency_p50_ms = round(float(np.percentile(seen.late_ms, 50)), 2)
            load.latency_p99_ms = round(float(np.percentile(seen.late_ms, 99)), 2)
        return load


def _extend(seen: _Seen, count: int, at_ns: int) -> None:
    seen.last = (count, at_ns)
    if seen.first is None:
        seen.first = seen.last
