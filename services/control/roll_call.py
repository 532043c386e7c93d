"""Who is there: every service says so once a second; the ones that should be there are known. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from common.messages import ServiceState
from common.service.liveness import GONE, Liveness, Seen

FORGET_AFTER_NS = 60_000_000_000
"""A service that nobody expects (a camera that was unplugged) leaves the list after this silence."""


class RollCall:
    """The services that have been heard, against those that are expected."""

    def __init__(self) -> None:
        self._liveness = Liveness()
        self._beats: Counter[str] = Counter()

    def hear(self, state: ServiceState, now_ns: int) -> None:
        """A heartbeat."""
        self._liveness.feed(state, now_ns)
        self._beats[state.service] += 1

    def tidy(self, expected: Iterable[str], now_ns: int) -> None:
        """Forget those that nobody expects, once they are long silent or properly stopped."""
        wanted = set(expected)
        for service, seen in self._liveness.seen().items():
            stopped = seen.state.phase == GONE
            if service not in wanted and (stopped or now_ns - seen.at_ns > FORGET_AFTER_NS):
                self._liveness.forget(service)

    @property
    def heard(self) -> dict[str, Seen]:
        """All that have been heard, by service id."""
        return dict(sorted(self._liveness.seen().items()))

    def beats(self, service: str) -> int:
        """How many heartbeats of it have been heard."""
        return self._beats[service]

    def alive(self, service: str, now_ns: int) -> bool:
        """Whether it spoke within 3 s and did not say good-bye."""
        return self._liveness.is_alive(service, now_ns)

    def missing(self, expected: Iterable[str], now_ns: int) -> tuple[str, ...]:
        """Those of ``expected`` that are not alive."""
        return tuple(sorted(service for service in set(expected) if not self.alive(service, now_ns)))


def expected_services(cameras: Iterable[str], detect: int, label: int) -> tuple[str, ...]:
    """The services of a complete stack."""
    return (
        *(f"capture.{camera}" for camera in sorted(set(cameras))),
        *(f"detect.{instance}" for instance in range(detect)),
        *(f"label.{instance}" for instance in range(label)),
        "store",
        "control",
    )
