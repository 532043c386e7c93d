"""The owner's side of a frame ring: one writer that waits for nobody."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import numpy as np

from common.frames.layout import NEWEST, Colour, Depth, Layout, header
from common.frames.segment import Segment

Fill = Callable[[Colour, Depth | None], None]


class FrameWriter:
    """Makes and owns a ring of ``slots`` pictures of ``width`` x ``height``, with depth if ``has_depth``.

    Frame n lies in slot n % slots. ``begin`` and ``end`` of its slot are n only while its pixels are whole;
    the slot that comes next is invalidated before n is announced, so a reader has the newest ``slots - 1``
    frames. Numbers begin at ``first``, so that a camera's second ring goes on where its first one ended.
    Raises NoSpaceError or NameTakenError. Use from one thread.
    """

    def __init__(self, name: str, width: int, height: int, has_depth: bool, slots: int, *, first: int = 1) -> None:
        self.layout = Layout("frames", width, height, slots, has_depth)
        self._segment = Segment.create(name, self.layout.size)
        buffer = self._segment.buffer
        self._begin, self._end = self.layout.control(buffer)
        self._header = header(buffer)
        self._slots = [self.layout.pictures(buffer, slot) for slot in range(slots)]
        self._next = first
        self.layout.write_header(buffer)

    @property
    def name(self) -> str:
        """The segment's name, as announced."""
        return self._segment.name

    @property
    def newest(self) -> int:
        """The number of the newest whole frame (``first`` - 1 before any)."""
        return self._next - 1

    def write(self, bgr: Colour | None, depth: Depth | None = None, fill: Fill | None = None) -> int:
        """Put a frame into the ring; returns its number.

        ``bgr`` (H, W, 3) uint8 and ``depth`` (H, W) uint16 are copied; a missing depth is written as 0 (invalid).
        With ``fill`` the pictures are made in place instead: it gets the slot's arrays and must set every
        pixel. Raises ValueError for a wrong shape, dtype or a depth that the ring has no room for.
        """
        number = self._next
        slot = number % self.layout.slots
        if fill is None:
            self._check(bgr, depth)
        pictures = self._slots[slot]
        # Each number is one 8-byte store of a numpy item; struct.pack_into would zero its target first.
        self._begin[slot] = number
        try:
            if fill is not None:
                fill(pictures.bgr, pictures.depth)
            else:
                assert bgr is not None
                np.copyto(pictures.bgr, bgr)
                if pictures.depth is not None:
                    np.copyto(pictures.depth, np.uint16(0) if depth is None else depth)
        except BaseException:
            self._begin[slot] = 0
            raise
        self._end[slot] = number
        self._begin[(number + 1) % self.layout.slots] = 0
        self._header[NEWEST] = number
        self._next = number + 1
        return number

    def close(self) -> None:
        """Remove the ring; readers that have it mapped keep what they see. May be called again."""
        if self._segment.closed:
            return
        self._slots = []
        del self._begin, self._end, self._header
        self._segment.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self, bgr: Colour | None, depth: Depth | None) -> None:
        shape = (self.layout.height, self.layout.width)
        if bgr is None or bgr.shape != (*shape, 3) or bgr.dtype != np.uint8:
            given = "nothing" if bgr is None else f"{bgr.shape} {bgr.dtype}"
            raise ValueError(f"ring {self.name} takes {(*shape, 3)} uint8, got {given}")
        if depth is None:
            return
        if not self.layout.has_depth:
            raise ValueError(f"ring {self.name} was made without depth")
        if depth.shape != shape or depth.dtype != np.uint16:
            raise ValueError(f"ring {self.name} takes depth {shape} uint16, got {depth.shape} {depth.dtype}")
