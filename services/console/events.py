"""A service that dies and comes back is seen to do so: an event for each, with how long it was away."""

from __future__ import annotations

from common.messages import ServiceState
from common.service.liveness import GONE, MISSING_AFTER_S
from services.console.hub import StateHub

_SLACK_NS = int(MISSING_AFTER_S * 1e9)


class ServiceWatch:
    """Heartbeats in, ``service_lost`` and ``service_back`` out; quiet until ``quiet_until_ns``."""

    def __init__(self, hub: StateHub, quiet_until_ns: int) -> None:
        self._hub = hub
        self._quiet_until_ns = quiet_until_ns
        self._last: dict[str, tuple[str, int]] = {}
        self._lost: dict[str, int] = {}

    def hear(self, state: ServiceState, now_ns: int) -> None:
        """A heartbeat: perhaps of one that had died."""
        before = self._last.get(state.service)
        self._last[state.service] = (state.boot, now_ns)
        if before is None:
            return
        boot, seen_ns = before
        if state.phase == GONE:
            self._gone(state.service, seen_ns, now_ns)
        elif state.service in self._lost or boot != state.boot:
            self._back(state.service, self._lost.pop(state.service, seen_ns), now_ns)

    def tick(self, now_ns: int) -> None:
        """Time has passed: who fell silent?"""
        for service, (_, seen_ns) in self._last.items():
            if service not in self._lost and now_ns - seen_ns > _SLACK_NS:
                self._gone(service, seen_ns, now_ns)

    def _gone(self, service: str, seen_ns: int, now_ns: int) -> None:
        if service in self._lost:
            return
        self._lost[service] = seen_ns
        if now_ns >= self._quiet_until_ns:
            what = "Its supervisor starts it anew; if it doesn't come back, look at its log."
            self._hub.happened("service_lost", f"{service} stopped.", service=service, what_to_do=what)

    def _back(self, service: str, lost_ns: int, now_ns: int) -> None:
        if now_ns >= self._quiet_until_ns:
            away_s = round((now_ns - lost_ns) / 1e9, 1)
            self._hub.happened(
                "service_back", f"{service} came back after {away_s:g} s.", service=service, lost_s=away_s
            )
