"""The frame rings of one camera's life: one at a time, a new one when the pictures change in size."""

from __future__ import annotations

from common import clock
from common.errors import NoSpaceError
from common.frames import FrameWriter, segment_name
from services.capture.cameras.base import Grabbed

KEEP_OLD_NS = 5_000_000_000
"""How long the ring before the present one stays, so that a reader that is behind can still map it."""


class Rings:
    """Makes rings named after ``owner``; frame numbers go on from one ring to the next."""

    def __init__(self, prefix: str, owner: str, boot: str, slots: int) -> None:
        self._prefix = prefix
        self._owner = owner
        self._boot = boot
        self._slots = slots
        self._made = 0
        self._newest = 0
        self._current: FrameWriter | None = None
        self._old: FrameWriter | None = None
        self._drop_old_at_ns = 0

    @property
    def name(self) -> str:
        """The present ring's name; empty before the first."""
        return "" if self._current is None else self._current.name

    def fit(self, width: int, height: int, has_depth: bool) -> bool:
        """Have a ring for such pictures; True if that is a new one. Raises NoSpaceError."""
        if self._current is not None:
            layout = self._current.layout
            if (layout.width, layout.height, layout.has_depth) == (width, height, has_depth):
                return False
        self._drop_old()
        first = self._newest + 1
        self._made += 1
        owner = self._owner if self._made == 1 else f"{self._owner}.{self._made}"
        name = segment_name(self._prefix, owner, self._boot)
        try:
            made = FrameWriter(name, width, height, has_depth, self._slots, first=first)
        except NoSpaceError:
            if self._current is None:
                raise
            # No room for both: who is behind loses the frames of the old ring.
            self._current.close()
            self._current = None
            made = FrameWriter(name, width, height, has_depth, self._slots, first=first)
        self._old, self._current = self._current, made
        self._drop_old_at_ns = clock.monotonic_ns() + KEEP_OLD_NS
        return True

    def write(self, grabbed: Grabbed) -> int:
        """Put a frame into the ring made by ``fit``; returns its number."""
        assert self._current is not None
        if self._old is not None and clock.monotonic_ns() > self._drop_old_at_ns:
            self._drop_old()
        depth = grabbed.depth if self._current.layout.has_depth else None
        self._newest = self._current.write(grabbed.bgr, depth)
        return self._newest

    def close(self) -> None:
        """Remove the rings; idempotent."""
        self._drop_old()
        if self._current is not None:
            self._current.close()
            self._current = None

    def _drop_old(self) -> None:
        if self._old is not None:
            self._old.close()
            self._old = None
