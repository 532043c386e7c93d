"""How a segment's bytes are arranged: header, control lines, then slots of pictures.

::

    0      header: 16 uint64 items; the magic number is written last, so a header is whole or not there
    128    one 64-byte control line a slot: begin, end (uint64 each; used by frame rings only)
    4096*  slot 0: colour (H, W, 3) uint8 | depth (H, W) uint16 | original (H, W, 3) uint8
           slot 1 ...                     every slot starts on a page, every picture on 64 bytes
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from common.errors import FrameLostError

Buffer = memoryview
Colour = NDArray[np.uint8]
Depth = NDArray[np.uint16]
Numbers = NDArray[np.uint64]
Kind = Literal["frames", "samples"]

MAGIC = int.from_bytes(b"tagmill\0", "little")
VERSION = 1
PAGE = 4096
LINE = 64
HEADER_ITEMS = 16
HEADER_BYTES = HEADER_ITEMS * 8
LARGEST_SIDE = 1 << 16
MOST_SLOTS = 1 << 12

# Places in the header.
_MAGIC, _VERSION, _KIND, _WIDTH, _HEIGHT, _DEPTH, _ORIGINAL, _SLOTS, NEWEST = range(9)
_KINDS: tuple[Kind, ...] = ("frames", "samples")


@dataclass(frozen=True, slots=True)
class Pictures:
    """The arrays of one slot: ``bgr`` (H, W, 3) uint8, ``depth`` (H, W) uint16, ``original`` like ``bgr``."""

    bgr: Colour
    depth: Depth | None
    original: Colour | None


@dataclass(frozen=True, slots=True)
class Layout:
    """The arrangement of one segment. Raises ValueError for sizes that no segment has."""

    kind: Kind
    width: int
    height: int
    slots: int
    has_depth: bool = False
    has_original: bool = False

    def __post_init__(self) -> None:
        if not (0 < self.width <= LARGEST_SIDE and 0 < self.height <= LARGEST_SIDE):
            raise ValueError(f"no picture has {self.width}x{self.height} pixels")
        fewest = 2 if self.kind == "frames" else 1
        if not fewest <= self.slots <= MOST_SLOTS:
            raise ValueError(f"a ring of {self.kind} has {fewest} to {MOST_SLOTS} slots, not {self.slots}")

    @property
    def colour_bytes(self) -> int:
        """Bytes of one colour picture."""
        return self.width * self.height * 3

    @property
    def depth_bytes(self) -> int:
        """Bytes of one depth picture, 0 without depth."""
        return self.width * self.height * 2 if self.has_depth else 0

    @property
    def slot_bytes(self) -> int:
        """Bytes from one slot to the next."""
        end = self._original_offset + (self.colour_bytes if self.has_original else 0)
        return _up(end, PAGE)

    @property
    def first_slot(self) -> int:
        """Where slot 0 begins."""
        return _up(HEADER_BYTES + self.slots * LINE, PAGE)

    def slot_start(self, slot: int) -> int:
        """Where a slot begins."""
        return self.first_slot + slot * self.slot_bytes

    @property
    def size(self) -> int:
        """Bytes of the whole segment."""
        return self.first_slot + self.slots * self.slot_bytes

    @property
    def _depth_offset(self) -> int:
        return _up(self.colour_bytes, LINE)

    @property
    def _original_offset(self) -> int:
        return self._depth_offset + _up(self.depth_bytes, LINE)

    def write_header(self, buffer: Buffer) -> None:
        """Describe the segment in its first bytes, the magic number last."""
        items = header(buffer)
        items[_VERSION] = VERSION
        items[_KIND] = _KINDS.index(self.kind)
        items[_WIDTH], items[_HEIGHT], items[_SLOTS] = self.width, self.height, self.slots
        items[_DEPTH], items[_ORIGINAL] = int(self.has_depth), int(self.has_original)
        items[NEWEST] = 0
        items[_MAGIC] = MAGIC

    @classmethod
    def read_header(cls, buffer: Buffer, name: str, kind: Kind) -> Layout:
        """The layout of a mapped segment; raises FrameLostError if it is no (whole) ring of this kind."""
        if len(buffer) < HEADER_BYTES:
            raise FrameLostError(f"the segment {name} has no header yet; its owner has just begun, try again")
        items = [int(item) for item in header(buffer)]
        if items[_MAGIC] != MAGIC:
            raise FrameLostError(f"the segment {name} is no ring of tagmill (or not ready yet)")
        if items[_VERSION] != VERSION:
            raise FrameLostError(
                f"the segment {name} has layout version {items[_VERSION]}, this tagmill reads {VERSION}; "
                "all services of a stack must be of the same release"
            )
        if items[_KIND] != _KINDS.index(kind):
            raise FrameLostError(f"the segment {name} is not a ring of {kind}")
        if items[_DEPTH] > 1 or items[_ORIGINAL] > 1:
            raise FrameLostError(f"the segment {name} has a damaged header: a flag is neither 0 nor 1")
        try:
            layout = cls(
                kind=kind,
                width=items[_WIDTH],
                height=items[_HEIGHT],
                slots=items[_SLOTS],
                has_depth=bool(items[_DEPTH]),
                has_original=bool(items[_ORIGINAL]),
            )
        except ValueError as error:
            raise FrameLostError(f"the segment {name} has a damaged header: {error}") from error
        if layout.size != len(buffer):
            raise FrameLostError(f"the segment {name} has {len(buffer)} bytes where its header says {layout.size}")
        return layout

    def control(self, buffer: Buffer) -> tuple[Numbers, Numbers]:
        """The numbers ``begin`` and ``end`` of all slots, each (slots,) uint64, 8-byte aligned."""
        lines = np.frombuffer(buffer, np.uint64, self.slots * LINE // 8, HEADER_BYTES)
        table = lines.reshape(self.slots, LINE // 8)
        return table[:, 0], table[:, 1]

    def pictures(self, buffer: Buffer, slot: int) -> Pictures:
        """The arrays of one slot, writable where the mapping is; raises IndexError for a slot that isn't."""
        if not 0 <= slot < self.slots:
            raise IndexError(f"slot {slot} of a ring with {self.slots}")
        start = self.slot_start(slot)
        pixels = self.width * self.height
        bgr = np.frombuffer(buffer, np.uint8, self.colour_bytes, start)
        depth = original = None
        if self.has_depth:
            depth = np.frombuffer(buffer, np.uint16, pixels, start + self._depth_offset)
            depth = depth.reshape(self.height, self.width)
        if self.has_original:
            original = np.frombuffer(buffer, np.uint8, self.colour_bytes, start + self._original_offset)
            original = original.reshape(self.height, self.width, 3)
        return Pictures(bgr.reshape(self.height, self.width, 3), depth, original)


def header(buffer: Buffer) -> Numbers:
    """The header's items (16,) uint64."""
    return np.frombuffer(buffer, np.uint64, HEADER_ITEMS)


def _up(value: int, multiple: int) -> int:
    return -(-value // multiple) * multiple
