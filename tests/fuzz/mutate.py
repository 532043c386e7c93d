"""Inputs near the seeds: a broken neighbour of a good file gets further than noise."""

from __future__ import annotations

import random

from tests.fuzz.targets import Target


def mutated(target: Target, number: int) -> bytes:
    """Input ``number`` of a target, always the same: a seed with a few cuts, insertions and repetitions, or noise."""
    chance = random.Random(number)
    data = chance.choice(target.seeds) if chance.random() < 0.9 else b""
    for _ in range(chance.randint(0, 4)):
        at, cut = chance.randint(0, len(data)), chance.choice((0, 0, 1, 4, 40))
        piece = chance.choice(target.words) if chance.random() < 0.6 else chance.randbytes(chance.randint(0, 8))
        data = data[:at] + piece * chance.randint(0, 3) + data[at + cut :]
    return data
