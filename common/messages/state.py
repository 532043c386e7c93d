"""State topics: repeated at 1 Hz, so that whoever comes late knows within a second."""

from __future__ import annotations

from typing import Literal

from common.labels import Part
from common.ledgers import Ledger
from common.messages.base import Message

ServicePhase = Literal["starting", "running", "faulty", "draining", "stopped"]


class Warned(Part):
    """A warning for the operator: when (wall ns), a code, one plain sentence."""

    wall_ns: int
    code: str
    message: str


class ServiceState(Message):
    """A service's heartbeat. ``dropped`` counts by place since start, ``rates`` are per second.

    ``texts`` are what is no number (the store's ``session``, and the code of its ``problem``).
    """

    service: str
    instance: int = 0
    camera: str | None = None
    boot: str
    pid: int
    phase: ServicePhase
    cameras: tuple[str, ...] = ()
    rates: dict[str, float] = {}
    dropped: dict[str, int] = {}
    numbers: dict[str, float] = {}
    texts: dict[str, str] = {}
    last_error: str | None = None
    warnings: tuple[Warned, ...] = ()


class Shares(Message):
    """Which instance of detect and of label serves which camera (control shares them out, and keeps to it)."""

    detect: dict[str, int]
    label: dict[str, int]


class AutoSeen(Part):
    """An object as `mode: auto` sees it in the newest frame, beside its limits.

    ``new_deg``: degrees to the nearest view taken from about that distance; ``new_mm``: mm to the nearest one from
    about that direction; None where there is none. ``sharpness`` None: not measured (yet).
    """

    object: str
    new_deg: float | None
    new_mm: float | None
    sharpness: float | None
    fit_px: float


class AutoNow(Part):
    """What `mode: auto` thinks of frame ``frame``; ``reason`` is why it isn't taken, None: it is worth a sample."""

    frame: int
    reason: str | None
    objects: tuple[AutoSeen, ...]


class RecordingState(Message):
    """A recording as its label process sees it; ``waiting_for`` is the last reason for which no sample was taken.

    With the mode `auto` it is told five times a second, with ``auto``.
    """

    camera: str
    ledger: Ledger
    waiting_for: str | None = None
    auto: AutoNow | None = None
