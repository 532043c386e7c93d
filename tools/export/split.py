"""Parting samples into training, validation and test set, so that none of them has a neighbour in another.

Whole units (sessions, time blocks, cameras) go to one side, drawn by a seed. At the seams, and where a scene comes
back, near-duplicates remain: pictures that look alike with the objects at the same place. Those are taken out of the
*training* set; if that takes too much of it, the split is refused instead of called a validation.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader
from common.errors import RefusedError
from common.quality import ALIKE_BITS, ALIKE_DEG, ALIKE_SHARE, differing_bits, near_views, perceptual_hash
from tools.export.model import SPLITS, Source, SplitName
from tools.export.options import SplitWish

BLOCKS = 12
"""At least so many time blocks are made of the samples, so that shares can be met."""
SHORTEST = 5
"""Samples of a block at least, where no pause ends it: blocks of one would be frames drawn at random."""
GAP_NS = 10_000_000_000
"""A pause this long ends a block."""
MOST_LEFT_OUT = 0.25
"""Of the training set, as neighbours of what is held back; above this the split is refused."""


@dataclass(frozen=True)
class Parted:
    """Each sample's part (None: left out of the training set as a neighbour) and unit, and how it was done."""

    parts: tuple[SplitName | None, ...]
    units: tuple[str, ...]
    by: str
    reasons: tuple[str, ...]

    @property
    def left_out(self) -> int:
        """Samples that are in no part."""
        return sum(part is None for part in self.parts)


def part(sources: Sequence[Source], wish: SplitWish, workers: int) -> Parted:
    """Part the samples; raises RefusedError where there is nothing that could be held back without leaking."""
    if wish.by == "none" or wish.val + wish.test == 0:
        why = "nothing was held back (--split none)" if wish.by == "none" else "no share was held back"
        everything: list[SplitName | None] = ["train"] * len(sources)
        return Parted(tuple(everything), ("all",) * len(sources), "none", (why,))
    by = wish.by
    if by == "auto":
        by = "session" if len({source.folder for source in sources}) >= 3 else "block"
    units = _units(sources, by)
    _enough(units, by, wish)
    drawn = _draw(units, wish)
    parts: list[SplitName | None] = [drawn[unit] for unit in units]
    leaks = _neighbours(sources, parts, workers)
    for index in leaks:
        parts[index] = None
    return Parted(tuple(parts), tuple(units), by, _reasons(parts, units, by, wish, len(leaks)))


def _units(sources: Sequence[Source], by: str) -> list[str]:
    if by == "session":
        return [str(source.folder.name) for source in sources]
    if by == "camera":
        return [source.label.camera.name for source in sources]
    return _blocks(sources)


def _blocks(sources: Sequence[Source]) -> list[str]:
    """Time blocks within each session: ended by a pause, and cut where they would be too long.

    All cameras of a session share its blocks, since they see the same thing at the same time.
    """
    longest = max(-(-len(sources) // BLOCKS), SHORTEST)
    found = [""] * len(sources)
    sessions: dict[str, list[int]] = {}
    for index, source in enumerate(sources):
        sessions.setdefault(str(source.folder), []).append(index)
    for indices in sessions.values():
        indices.sort(key=lambda index: sources[index].label.captured_wall_ns)
        block, length, last = 0, 0, sources[indices[0]].label.captured_wall_ns
        for index in indices:
            now = sources[index].label.captured_wall_ns
            if length and (now - last > GAP_NS or (length >= longest and now > last)):
                block, length = block + 1, 0
            found[index] = f"{sources[index].folder.name}#{block + 1}"
            length, last = length + 1, now
    return found


def _enough(units: Sequence[str], by: str, wish: SplitWish) -> None:
    wanted = 1 + (wish.val > 0) + (wish.test > 0)
    if len(set(units)) < wanted:
        raise RefusedError(
            f"a split by {by} needs at least {wanted} of them, there {'is' if len(set(units)) == 1 else 'are'} "
            f"{len(set(units))}; record more, or take --split none",
            code="refused",
        )


def _draw(units: Sequence[str], wish: SplitWish) -> dict[str, SplitName]:
    """Which unit goes where: in an order drawn by the seed, each to the held-back part that lacks it most."""
    sizes = Counter(units)
    order = sorted(sizes)
    random.Random(wish.seed).shuffle(order)  # noqa: S311 - a reproducible draw, no secret
    wanted: dict[SplitName, float] = {"val": wish.val * len(units), "test": wish.test * len(units)}
    held = [name for name in SPLITS if wanted.get(name, 0) > 0]
    has = dict.fromkeys(held, 0)
    drawn: dict[str, SplitName] = {}
    for unit in order:
        lacking = max(held, key=lambda name: wanted[name] - has[name])
        if sizes[unit] / 2 <= wanted[lacking] - has[lacking]:
            drawn[unit] = lacking
            has[lacking] += sizes[unit]
        else:
            drawn[unit] = "train"
    return _settled(drawn, order, held)


def _settled(drawn: dict[str, SplitName], order: Sequence[str], held: Sequence[SplitName]) -> dict[str, SplitName]:
    """No part may be empty: the last units drawn fill what is."""
    for name in ("train", *held):
        if name not in drawn.values():
            counts = Counter(drawn.values())
            giver = next(unit for unit in reversed(order) if counts[drawn[unit]] > 1)
            drawn[giver] = name
    return drawn


def _neighbours(sources: Sequence[Source], parts: Sequence[SplitName | None], workers: int) -> list[int]:
    """Samples of the training set that are near-duplicates of held-back ones, and of val near those of test."""
    leaks: set[int] = set()
    hashes = _Hashes(sources, workers)
    ranks = {name: rank for rank, name in enumerate(SPLITS)}
    for held in ("test", "val"):
        kept = [i for i, part in enumerate(parts) if part == held and i not in leaks]
        others = [i for i, part in enumerate(parts) if part is not None and ranks[part] < ranks[held]]
        if not kept or not others:
            continue
        near = near_views([sources[i].poses for i in kept], [sources[i].poses for i in others])
        needed = {kept[row] for row in np.flatnonzero(near.any(axis=1))}
        needed |= {others[column] for column in np.flatnonzero(near.any(axis=0))}
        hashes.make(sorted(needed))
        numbers = np.array([hashes.known.get(i, 0) for i in others], dtype=np.uint64)
        for row, index in enumerate(kept):
            columns = np.flatnonzero(near[row])
            if len(columns):
                alike = differing_bits(hashes.known[index], numbers[columns]) <= ALIKE_BITS
                leaks.update(others[column] for column in columns[alike])
    return sorted(leaks)


class _Hashes:
    """Perceptual hashes, made only of those samples that are near another by pose."""

    def __init__(self, sources: Sequence[Source], workers: int) -> None:
        self._sources, self._workers = sources, workers
        self.known: dict[int, int] = {}

    def make(self, indices: Sequence[int]) -> None:
        """Make what is not there yet."""
        wanted = [index for index in indices if index not in self.known]
        with ThreadPoolExecutor(self._workers) as pool:
            self.known.update(zip(wanted, pool.map(self._of, wanted), strict=True))

    def _of(self, index: int) -> int:
        source = self._sources[index]
        picture: NDArray[np.uint8] = SessionReader(source.folder).colour(source.label)
        return perceptual_hash(picture)


def _reasons(
    parts: Sequence[SplitName | None], units: Sequence[str], by: str, wish: SplitWish, leaks: int
) -> tuple[str, ...]:
    """How it was done, in sentences; raises RefusedError if too much of the training set is a neighbour."""
    counts = Counter(parts)
    training = counts["train"] + leaks
    shares: dict[SplitName, float] = {"val": wish.val, "test": wish.test}
    if (
        any(share > 0 and counts[name] == 0 for name, share in shares.items())
        or leaks > MOST_LEFT_OUT * training
        or not counts["train"]
    ):
        raise RefusedError(
            f"that would be no validation set: {leaks} of {training} training samples show the same as one that is "
            f"held back (same picture, same pose); record another session for it, or take --split none",
            code="refused",
        )
    near = f"hashes within {ALIKE_BITS} of 64 bits, {ALIKE_DEG:g} degrees, {ALIKE_SHARE:.0%} of the distance"
    return (
        f"by {by}, seed {wish.seed}: {len(set(units))} units, each wholly in one part",
        f"{leaks} samples left out: near-duplicates of one that is held back ({near})",
    )
