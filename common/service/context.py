"""What a service is given, and what it gives back."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from structlog.typing import FilteringBoundLogger

from common.bus import Endpoints
from common.messages import Warned

if TYPE_CHECKING:
    from common.config import Rig


@dataclass(frozen=True, slots=True)
class Context:
    """One life (``boot``) of one service; ``id`` is unique in a stack: ``capture.cam0``, ``label.0``, ``store``."""

    rig: Rig
    endpoints: Endpoints
    name: str
    id: str
    instance: int
    camera: str | None
    boot: str
    log: FilteringBoundLogger
    args: argparse.Namespace


@dataclass(frozen=True, slots=True)
class Report:
    """What the heartbeat tells of a service; ``faulty`` = it runs but can't do its work (see ``last_error``)."""

    cameras: tuple[str, ...] = ()
    rates: dict[str, float] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    last_error: str | None = None
    faulty: bool = False
    warnings: tuple[Warned, ...] = ()


class Service(Protocol):
    """A service as the runner sees it; all methods are called from the main thread."""

    def __init__(self, context: Context) -> None:
        """Cheap: nothing is opened yet."""

    def open(self) -> None:
        """Bind, connect, map. Raises ConfigError, NameTakenError (tried again later) or another TagmillError."""

    def step(self, timeout_s: float) -> None:
        """One round of work; waits for input at most ``timeout_s``."""

    def drain(self) -> bool:
        """Called between steps once a stop was requested; True = nothing is left to finish."""

    def close(self) -> None:
        """Give everything back; idempotent, also after an ``open`` that failed half-way."""

    def report(self) -> Report:
        """Cheap: a few times a second."""
