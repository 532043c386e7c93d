"""The sample ring: pixels of ordered samples, kept until the store has answered.

Unlike a frame ring nothing is ever overwritten: the owner (label) takes a slot, hands its number on with an
order, and gives the slot back when the answer has come. The ring's name holds the owner's boot id, so a slot
number of an earlier life can't be taken for one of this life.
"""

from __future__ import annotations

from typing import Self

from common.errors import FrameLostError
from common.frames.layout import Layout, Pictures
from common.frames.segment import Segment


class SampleRing:
    """Makes and owns ``slots`` slots of ``width`` x ``height``: colour, optional depth, optional original.

    Raises NoSpaceError or NameTakenError. Use from one thread.
    """

    def __init__(
        self, name: str, width: int, height: int, has_depth: bool, slots: int, with_original: bool = False
    ) -> None:
        self.layout = Layout("samples", width, height, slots, has_depth, with_original)
        self._segment = Segment.create(name, self.layout.size, first=self.layout.first_slot)
        self.layout.write_header(self._segment.buffer)
        self._free = list(reversed(range(slots)))
        self._taken: set[int] = set()
        self._used: set[int] = set()

    @property
    def name(self) -> str:
        """The segment's name, as it goes into orders."""
        return self._segment.name

    @property
    def free(self) -> int:
        """How many slots can still be acquired."""
        return len(self._free)

    def acquire(self) -> int | None:
        """Take a slot; None if all are taken.

        The one that was given back last: while little waits, few slots go round, and their pixels stay in the caches
        and the pages of whoever maps them. A slot gets its memory when it is first taken, since all at once would hold
        up the frames of every camera: NoSpaceError if others have taken that memory since the ring was made.
        """
        if not self._free:
            return None
        slot = self._free[-1]
        if slot not in self._used:
            self._segment.allocate(self.layout.slot_start(slot), self.layout.slot_bytes)
            self._used.add(slot)
        self._free.pop()
        self._taken.add(slot)
        return slot

    def view(self, slot: int) -> Pictures:
        """The writable arrays of an acquired slot; raises ValueError for one that isn't."""
        self._check(slot)
        return self.layout.pictures(self._segment.buffer, slot)

    def release(self, slot: int) -> None:
        """Give a slot back; raises ValueError for one that isn't acquired."""
        self._check(slot)
        self._taken.remove(slot)
        self._free.append(slot)

    def close(self) -> None:
        """Remove the ring; who has it mapped keeps what it sees. May be called again."""
        self._segment.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self, slot: int) -> None:
        if slot not in self._taken:
            raise ValueError(f"slot {slot} of the sample ring {self.name} is not acquired")


class SampleSlots:
    """Another process's map of a sample ring; ``writable`` for the eraser, the store only reads.

    Raises FrameLostError if the ring is gone or isn't a sample ring. Once mapped, the pixels stay readable
    even if the owner dies.
    """

    def __init__(self, name: str, *, writable: bool = False) -> None:
        self._segment = Segment.attach(name, writable=writable)
        try:
            self.layout = Layout.read_header(self._segment.buffer, name, "samples")
        except FrameLostError:
            self._segment.close()
            raise

    @property
    def name(self) -> str:
        """The segment's name."""
        return self._segment.name

    @property
    def abandoned(self) -> bool:
        """Whether the owner has removed the ring, or it was swept after its death: nothing new comes in it."""
        return self._segment.abandoned

    def view(self, slot: int) -> Pictures:
        """The arrays of a slot; raises FrameLostError for a slot that the ring doesn't have."""
        if not 0 <= slot < self.layout.slots:
            raise FrameLostError(f"the sample ring {self.name} has {self.layout.slots} slots, no slot {slot}")
        return self.layout.pictures(self._segment.buffer, slot)

    def close(self) -> None:
        """Unmap the ring. May be called again."""
        self._segment.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
