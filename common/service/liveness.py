"""Who is alive, from the heartbeats alone. Pure: the caller gives the time."""

from __future__ import annotations

from dataclasses import dataclass

from common.messages import ServiceState

MISSING_AFTER_S = 3.0
GONE = "stopped"


@dataclass(frozen=True, slots=True)
class Seen:
    """A service's newest state, when it came (monotonic ns), and how often it has restarted meanwhile."""

    state: ServiceState
    at_ns: int
    restarts: int = 0


class Liveness:
    """Collects ServiceState messages by service id."""

    def __init__(self, missing_after_s: float = MISSING_AFTER_S) -> None:
        self._limit_ns = int(missing_after_s * 1e9)
        self._seen: dict[str, Seen] = {}

    def feed(self, state: ServiceState, now_ns: int) -> bool:
        """Take a state; True if the service is new or in a new life (another boot)."""
        before = self._seen.get(state.service)
        fresh = before is None or before.state.boot != state.boot
        restarts = 0 if before is None else before.restarts + fresh
        self._seen[state.service] = Seen(state, now_ns, restarts)
        return fresh

    def seen(self) -> dict[str, Seen]:
        """All that were ever seen, by id."""
        return dict(self._seen)

    def is_alive(self, service: str, now_ns: int) -> bool:
        """Whether the service gave a sign of life lately and didn't say good-bye."""
        seen = self._seen.get(service)
        return seen is not None and seen.state.phase != GONE and now_ns - seen.at_ns <= self._limit_ns

    def alive(self, now_ns: int) -> tuple[ServiceState, ...]:
        """The newest states of all that are alive, by id."""
        return tuple(seen.state for name, seen in sorted(self._seen.items()) if self.is_alive(name, now_ns))

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Ids of those that fell silent without a good-bye."""
        return tuple(
            name
            for name, seen in sorted(self._seen.items())
            if seen.state.phase != GONE and now_ns - seen.at_ns > self._limit_ns
        )

    def forget(self, service: str) -> None:
        """No longer expect it (its camera was removed)."""
        self._seen.pop(service, None)
