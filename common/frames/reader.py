"""A reader's side of a frame ring: sees a frame whole or not at all, and can't hold the writer up."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from common.errors import FrameLostError
from common.frames.layout import NEWEST, Colour, Depth, Layout, Pictures, header
from common.frames.segment import Segment


class FrameReader:
    """Maps the ring ``name`` read-only; raises FrameLostError if it is gone or not a frame ring.

    Ending (or killing) a reader changes nothing for the writer and the other readers.
    """

    def __init__(self, name: str) -> None:
        self._segment = Segment.attach(name)
        try:
            self.layout = Layout.read_header(self._segment.buffer, name, "frames")
        except FrameLostError:
            self._segment.close()
            raise
        buffer = self._segment.buffer
        self._begin, self._end = self.layout.control(buffer)
        self._header = header(buffer)
        self._slots: list[Pictures | None] = [None] * self.layout.slots

    @property
    def name(self) -> str:
        """The segment's name."""
        return self._segment.name

    def newest(self) -> int:
        """The number of the newest whole frame, 0 before the first."""
        self._open()
        return int(self._header[NEWEST])

    def view(self, number: int) -> FrameView:
        """Frame ``number`` in place, for a ``with`` block::

            with reader.view(n) as frame:
                grey = cv2.cvtColor(frame.bgr, cv2.COLOR_BGR2GRAY)
            # only here is it sure that grey was made from one whole frame

        Raises FrameLostError on entry if the frame isn't (or no longer) there, and on exit if it was
        overwritten meanwhile: then everything computed in the block must be discarded, not only copies.
        """
        return FrameView(self, number)

    def close(self) -> None:
        """Unmap the ring. May be called again."""
        if self._segment.closed:
            return
        del self._begin, self._end, self._header
        self._slots = []
        self._segment.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> None:
        if self._segment.closed:
            raise FrameLostError(f"the ring {self.name} is closed")

    def _pictures(self, number: int) -> Pictures:
        self._open()
        slot = number % self.layout.slots
        # The order matters: a writer sets begin first and end last.
        if number < 1 or int(self._end[slot]) != number or int(self._begin[slot]) != number:
            raise self._lost(number)
        pictures = self._slots[slot]
        if pictures is None:
            pictures = self._slots[slot] = self.layout.pictures(self._segment.buffer, slot)
        return pictures

    def _check_still_there(self, number: int) -> None:
        self._open()
        # ``begin``, not ``end``: the writer changes it before it touches the first pixel.
        if int(self._begin[number % self.layout.slots]) != number:
            raise self._lost(number)

    def _lost(self, number: int) -> FrameLostError:
        newest = int(self._header[NEWEST])
        oldest = max(1, newest - self.layout.slots + 2)
        return FrameLostError(f"frame {number} is not in the ring {self.name}, which holds {oldest} to {newest}")


class FrameView:
    """One frame of a ring inside a ``with`` block; see ``FrameReader.view``."""

    def __init__(self, reader: FrameReader, number: int) -> None:
        self.number = number
        self._reader = reader
        self._pictures: Pictures | None = None

    @property
    def bgr(self) -> Colour:
        """The colour picture (H, W, 3) uint8 BGR, read-only, in place."""
        return self._inside().bgr

    @property
    def depth(self) -> Depth | None:
        """The depth picture (H, W) uint16, read-only, in place; None for a ring without depth."""
        return self._inside().depth

    def __enter__(self) -> Self:
        self._pictures = self._reader._pictures(self.number)  # noqa: SLF001 - the view is the reader's other half
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pictures = None
        if error is None:
            self._reader._check_still_there(self.number)  # noqa: SLF001 - as above

    def _inside(self) -> Pictures:
        if self._pictures is None:
            raise RuntimeError("a FrameView is used inside its with block only")
        return self._pictures
