"""The heartbeat: a service's state, once a second and at every change."""

from __future__ import annotations

import os

from common import clock, log
from common.bus import Endpoints, Publisher
from common.messages import ServiceState
from common.service.context import Report
from common.service.cpu import CpuMeter
from common.service.states import Phase
from common.topics import SERVICE

_EVERY_NS = 1_000_000_000
_LAST_WORDS_S = 0.2


class Heartbeat:
    """Publishes ServiceState for one service. Lives in the main loop on purpose: a loop that hangs falls silent."""

    def __init__(self, endpoints: Endpoints, service_id: str, instance: int, camera: str | None, boot: str) -> None:
        self._id = service_id
        self._instance = instance
        self._camera = camera
        self._boot = boot
        self._publisher = Publisher(endpoints, service_id, boot)
        self._cpu = CpuMeter()
        self._next_ns = 0
        self._last: tuple[Phase, bool, str | None] | None = None

    def beat(self, phase: Phase, report: Report) -> None:
        """Publish if a second has passed or something changed that others wait for."""
        now = clock.monotonic_ns()
        key = (phase, report.faulty, report.last_error)
        if now < self._next_ns and key == self._last:
            return
        self._last = key
        self._next_ns = now + _EVERY_NS
        log.get().debug("service.report", phase=phase.value, rates=report.rates, numbers=report.numbers)
        dropped = dict(report.dropped)
        own = {"log": log.dropped(), "heartbeat": self._publisher.dropped}
        dropped.update({place: count for place, count in own.items() if count})
        state = ServiceState(
            service=self._id,
            instance=self._instance,
            camera=self._camera,
            boot=self._boot,
            pid=os.getpid(),
            phase=phase.value,
            cameras=report.cameras,
            rates=report.rates,
            dropped=dropped,
            numbers={"cpu_percent": self._cpu.percent(), **report.numbers},
            texts=report.texts,
            last_error=report.last_error,
            warnings=report.warnings,
        )
        self._publisher.publish(SERVICE, (self._id,), state)

    def close(self) -> None:
        """Close; the last state gets a moment to leave. Idempotent."""
        self._publisher.close(_LAST_WORDS_S)
