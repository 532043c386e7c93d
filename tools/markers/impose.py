"""Where things lie on the pages: rows from the top, in the given order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Block(Generic[Item]):
    """Something of a size, mm."""

    item: Item
    width: float
    height: float


@dataclass(frozen=True, slots=True)
class Placed(Generic[Item]):
    """A block with its page (from 0) and its top left corner from that of the area."""

    block: Block[Item]
    page: int
    x: float
    y: float


def impose(blocks: Sequence[Block[Item]], width: float, height: float, gap: float) -> list[Placed[Item]]:
    """Fill areas of ``width`` x ``height`` mm; each block must fit one. Rows are centred together."""
    pages: list[list[list[Block[Item]]]] = []
    for row in _rows(blocks, width, gap):
        tallest = max(block.height for block in row)
        used = sum(max(block.height for block in above) + gap for above in pages[-1]) if pages else 0.0
        if not pages or used + tallest > height + 1e-6:
            pages.append([])
        pages[-1].append(row)
    placed = []
    for number, rows in enumerate(pages):
        left = (width - max(_length(row, gap) for row in rows)) / 2
        y = 0.0
        for row in rows:
            x = left
            for block in row:
                placed.append(Placed(block, number, x, y))
                x += block.width + gap
            y += max(block.height for block in row) + gap
    return placed


def _rows(blocks: Sequence[Block[Item]], width: float, gap: float) -> list[list[Block[Item]]]:
    rows: list[list[Block[Item]]] = []
    for block in blocks:
        if rows and _length(rows[-1], gap) + gap + block.width <= width + 1e-6:
            rows[-1].append(block)
        else:
            rows.append([block])
    return rows


def _length(row: Sequence[Block[Item]], gap: float) -> float:
    return sum(block.width for block in row) + gap * (len(row) - 1)
