"""A service's states and which may follow which."""

from __future__ import annotations

from enum import StrEnum

from common.errors import StateError


class Phase(StrEnum):
    """The states; the words are those of ``ServiceState.phase``."""

    STARTING = "starting"
    RUNNING = "running"
    FAULTY = "faulty"
    DRAINING = "draining"
    STOPPED = "stopped"


TRANSITIONS: dict[Phase, frozenset[Phase]] = {
    Phase.STARTING: frozenset({Phase.RUNNING, Phase.FAULTY, Phase.DRAINING, Phase.STOPPED}),
    Phase.RUNNING: frozenset({Phase.FAULTY, Phase.DRAINING, Phase.STOPPED}),
    Phase.FAULTY: frozenset({Phase.RUNNING, Phase.DRAINING, Phase.STOPPED}),
    Phase.DRAINING: frozenset({Phase.STOPPED}),
    Phase.STOPPED: frozenset(),
}
"""``faulty``: it runs but can't do its work (camera lost, disk full) and says why in ``last_error``."""


class StateMachine:
    """Where a service is; ``enter`` refuses what the table doesn't have."""

    def __init__(self) -> None:
        self.phase = Phase.STARTING

    def enter(self, phase: Phase) -> bool:
        """Go to ``phase``; False if it is there already. Raises StateError for a forbidden step."""
        if phase is self.phase:
            return False
        if phase not in TRANSITIONS[self.phase]:
            raise StateError(f"a service that is {self.phase} can't become {phase}")
        self.phase = phase
        return True
