"""What the services say of their steps while something is recorded."""

from __future__ import annotations

from typing import Self

from common import clock
from common.bus import Endpoints, Poller, Subscriber
from common.errors import TagmillError
from common.messages import ServiceState
from common.topics import SERVICE

STEPS = {
    "detect": ("detect.0", "took_p50_ms"),
    "label (live)": ("label.0", "label_ms"),
    "copy": ("label.0", "copy_ms"),
    "refine, pose": ("label.0", "refine_ms"),
    "erase": ("label.0", "erase_ms"),
    "encode": ("store", "encode_ms"),
    "describe": ("store", "describe_ms"),
    "write, fsync": ("store", "write_ms"),
}
"""A step, the service that does it, and the number in its state; ``_cpu_ms`` in place of ``_ms`` is the CPU time."""
_HEARD_S = 5.0


class Steps:
    """Listens to the services' states."""

    def __init__(self, endpoints: Endpoints) -> None:
        self._subscriber = Subscriber(endpoints)
        self._subscriber.subscribe(SERVICE)
        self._poller = Poller(self._subscriber)
        self._numbers: dict[str, dict[str, float]] = {}
        self._sums: dict[str, list[float]] = {}
        self.listen_once()

    @property
    def bytes_written(self) -> float:
        """As the store said last."""
        return self._numbers["store"].get("bytes_written", 0.0)

    def listen(self, seconds: float) -> None:
        """For so long."""
        end = clock.monotonic_ns() + int(seconds * 1e9)
        while (left := end - clock.monotonic_ns()) > 0:
            self._poller.wait(min(left / 1e9, 0.2))
            self._hear()

    def listen_once(self) -> None:
        """Until each service has told its state from now on; raises TagmillError if one doesn't within 5 s."""
        self._numbers = {}
        services = {service for service, _ in STEPS.values()}
        end = clock.monotonic_ns() + int(_HEARD_S * 1e9)
        while missing := services - set(self._numbers):
            if clock.monotonic_ns() > end:
                raise TagmillError(f"{', '.join(sorted(missing))} said nothing of itself for {_HEARD_S:g} s")
            self._poller.wait(0.2)
            self._hear()

    def means(self) -> dict[str, float]:
        """Milliseconds a sample by step, ``STEP`` and, where it is known, ``STEP CPU``."""
        found = {}
        for step, (service, number) in STEPS.items():
            for name, key in ((step, number), (f"{step} CPU", number.replace("_ms", "_cpu_ms"))):
                values = self._sums.get(f"{service} {key}", ())
                if values:
                    found[name] = sum(values) / len(values)
        return found

    def _hear(self) -> None:
        for received in self._subscriber.receive():
            state = received.message
            if isinstance(state, ServiceState):
                self._numbers[state.service] = dict(state.numbers)
                for key, value in state.numbers.items():
                    self._sums.setdefault(f"{state.service} {key}", []).append(value)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.close()
