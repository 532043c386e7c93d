"""Watches the calls of a driver: one that hangs is said, and ends the process when it has hung for too long."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from structlog.typing import FilteringBoundLogger

from common import clock
from common.errors import CameraStuckError
from services.capture.announcer import Announcer

Call = Literal["open", "grab", "close"]

STALLED_S = 1.5
"""Three times the deadline that `grab` is given: such a driver doesn't heed it."""
STUCK_S: dict[Call, float] = {"grab": 30.0, "close": 30.0, "open": 300.0}
"""A call that takes longer ends the process: nothing else gets a thread out of a driver. To open may take long."""


class Watchdog:
    """The grab thread makes its calls `of` it; the main loop has to `look`."""

    def __init__(self, announcer: Announcer, log: FilteringBoundLogger) -> None:
        self._announcer = announcer
        self._log = log
        self._under_way: tuple[Call, int] | None = None

    @contextmanager
    def of(self, call: Call) -> Iterator[None]:
        """A call of the driver, for the length of the block."""
        self._under_way = (call, clock.monotonic_ns())
        try:
            yield
        finally:
            self._under_way = None

    def look(self) -> None:
        """Say so if the driver hangs; raises CameraStuckError once it has for too long."""
        under_way = self._under_way
        if under_way is None:
            return
        call, since_ns = under_way
        hung_s = (clock.monotonic_ns() - since_ns) / 1e9
        if hung_s > STUCK_S[call]:
            raise CameraStuckError(
                f"the driver has not come back from '{call}' for {hung_s:.0f} s: this process ends, for its "
                "supervisor to start it anew; if that happens again, unplug the camera and plug it in"
            )
        if hung_s > STALLED_S and self._announcer.stall(
            f"the driver does not come back from '{call}'; after {STUCK_S[call]:.0f} s its process is started anew"
        ):
            self._log.warning("camera.stalled", call=call, hung_s=round(hung_s, 1))
