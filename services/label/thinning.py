"""Which frames recordings get while samples come faster than the disk takes them. Pure.

The sample ring is the buffer, and its size the limit. Up to three quarters of it every frame is taken; from there on a
share of the frames that falls from one to none as the ring fills. The share settles where as many samples come as go,
and the frames that are left out lie evenly between the others (as Bresenham spreads the steps of a line).
"""

from __future__ import annotations

_RESERVED = 16
"""One slot in so many is never a recording's: a single request finds it free."""
_BUFFER = 0.75


def reserved(slots: int) -> int:
    """How many slots of a ring are kept for single requests; a ring of one or two has none to spare."""
    return max(1, slots // _RESERVED) if slots > 2 else 0


class Thinning:
    """One camera's. ``active`` from the first frame left out until the buffer is half empty again."""

    def __init__(self, slots: int) -> None:
        self._slots = slots
        self._most = slots - reserved(slots)
        self._owed = 1.0
        self.active = False

    def share(self, free: int) -> float:
        """The share of frames (0..1) that are taken while ``free`` slots of the ring are."""
        left = self._most - (self._slots - free)
        return min(max(left / max((1 - _BUFFER) * self._most, 1.0), 0.0), 1.0)

    def takes(self, free: int) -> bool:
        """Whether the next frame is taken."""
        share = self.share(free)
        self._owed = min(self._owed + share, 1.0) if share < 1.0 else 1.0
        if self._owed < 1.0 or share == 0.0:
            self.active = True
            return False
        self._owed -= 1.0
        if self._slots - free <= self._most // 2:
            self.active = False
        return True
