"""Listens to the cameras of a running stack, phase by phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from common import clock
from common.bus import Endpoints, Poller, Subscriber
from common.messages import CameraState, FrameAnnounced
from common.topics import CAMERA, FRAME
from tools.bench.capture_times import Captured, CaptureTimes, Jitter
from tools.bench.processes import Busy, Cores, Usage, usage_between, usage_now

_LOOK_NS = 1_000_000_000


@dataclass(frozen=True)
class Phase:
    """A part of the run: how evenly each camera captured, what the machine and the services used."""

    seconds: float
    jitter: dict[str, Jitter]
    machine: Busy
    processes: dict[str, Usage]


class Watch:
    """Every announced frame of every camera (``fps`` each), from the end of the warm-up on."""

    def __init__(self, endpoints: Endpoints, pids: Mapping[str, int], fps: float) -> None:
        self._pids, self._fps = pids, fps
        self._cameras: dict[str, CaptureTimes] = {}
        self._subscriber = Subscriber(endpoints)
        self._subscriber.subscribe(FRAME, every=True)
        self._subscriber.subscribe(CAMERA)
        self._poller = Poller(self._subscriber)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._subscriber.close()

    def warm_up(self, seconds: float) -> None:
        """Let the stack run, and forget what is heard."""
        self._listen(seconds, Cores())
        self._cameras.clear()

    def phase(self, seconds: float) -> Phase:
        """Listen for so long."""
        cores, before, began = Cores(), usage_now(self._pids), clock.monotonic_ns()
        self._listen(seconds, cores)
        ended = clock.monotonic_ns()
        usage = usage_between(before, usage_now(self._pids))
        jitter = {name: camera.jitter(began, ended) for name, camera in sorted(self._cameras.items())}
        return Phase((ended - began) / 1e9, jitter, cores.result(), usage)

    def captured(self) -> dict[str, Captured]:
        """The frames of all phases, by camera."""
        return {name: camera.captured() for name, camera in sorted(self._cameras.items())}

    def _listen(self, seconds: float, cores: Cores) -> None:
        now = clock.monotonic_ns()
        end, look = now + int(seconds * 1e9), now + _LOOK_NS
        while (now := clock.monotonic_ns()) < end:
            if now >= look:
                cores.look()
                look = now + _LOOK_NS
            self._poller.wait(min(end - now, look - now) / 1e9)
            self._hear()
        cores.look()

    def _hear(self) -> None:
        for received in self._subscriber.receive():
            match received.message:
                case FrameAnnounced(ref=ref):
                    self._camera(ref.camera).announced(ref)
                case CameraState() as state:
                    self._camera(state.camera.name).told(state)

    def _camera(self, name: str) -> CaptureTimes:
        return self._cameras.setdefault(name, CaptureTimes(self._fps))
