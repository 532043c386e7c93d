"""A sample against those before and after it: windows that jump, objects that vanish for one sample. Pure.

Only a sample that lies *between* its neighbours in time can be judged: where the object hardly moved from the one
to the other, it was in between. Recordings of single, far apart views have no such neighbours, and nothing is said.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.inspect.facts import Facts, ObjectFacts, Reason

_LEAST_PX = 6.0
_SHARE_OF_STEP = 1.5
"""A window may be off the way between its neighbours by so much of that way's length: objects turn and stop."""
_USUAL = 6.0
"""Times the session's median: how uneven this object's motion is."""
_VANISHED = 3.0
_STEADY_SHARE = 0.25
"""Neighbours' windows are alike if they differ by less than this share of their size."""


@dataclass(frozen=True, eq=False)
class _Seen:
    index: int
    wall_ns: int
    window: NDArray[np.float64]


def neighbour_reasons(facts: Sequence[Facts]) -> dict[int, list[Reason]]:
    """Reasons by the index of the sample; ``facts`` in any order, of any number of cameras."""
    found: dict[int, list[Reason]] = defaultdict(list)
    for name, chain in _chains(facts):
        for index, reason in _jumps(name, chain):
            found[index].append(reason)
    for camera in sorted({item.camera for item in facts}):
        for index, reason in _vanished(facts, camera):
            found[index].append(reason)
    return dict(found)


def _chains(facts: Sequence[Facts]) -> Iterator[tuple[str, list[_Seen]]]:
    """Each object as each camera saw it, in the order of time."""
    chains: dict[tuple[str, str], list[_Seen]] = defaultdict(list)
    for index, sample in enumerate(facts):
        for item in sample.objects:
            if np.isfinite(item.window).all():
                chains[sample.camera, item.name].append(_Seen(index, sample.wall_ns, item.window))
    for (_, name), chain in chains.items():
        yield name, sorted(chain, key=lambda seen: seen.wall_ns)


def _jumps(name: str, chain: list[_Seen]) -> Iterator[tuple[int, Reason]]:
    """The worst first; each is taken out before the others are judged, so that its neighbours aren't blamed for it."""
    usual = float(np.median([_off(chain, at)[0] for at in range(1, len(chain) - 1)])) if len(chain) > 2 else 0.0
    while len(chain) > 2:
        scores = []
        for at in range(1, len(chain) - 1):
            off, step = _off(chain, at)
            scores.append(off / (_LEAST_PX + _USUAL * usual + _SHARE_OF_STEP * step))
        worst = int(np.argmax(scores)) + 1
        score = scores[worst - 1]
        if score <= 1.0:
            return
        off, step = _off(chain, worst)
        text = f"{name}'s window is {off:.0f} px from where the samples before and after put it ({step:.0f} px apart)"
        yield chain[worst].index, Reason("jump", text, score)
        chain = chain[:worst] + chain[worst + 1 :]


def _off(chain: Sequence[_Seen], at: int) -> tuple[float, float]:
    """How far (px) a window is from the way between its neighbours', and how far those are apart."""
    before, here, after = chain[at - 1], chain[at], chain[at + 1]
    span = after.wall_ns - before.wall_ns
    share = (here.wall_ns - before.wall_ns) / span if span > 0 else 0.5
    expected = before.window + share * (after.window - before.window)
    return float(np.abs(here.window - expected).max()), float(np.abs(after.window - before.window).max())


def _vanished(facts: Sequence[Facts], camera: str) -> Iterator[tuple[int, Reason]]:
    order = sorted(
        (index for index, item in enumerate(facts) if item.camera == camera and item.readable),
        key=lambda index: facts[index].wall_ns,
    )
    for before, here, after in zip(order, order[1:], order[2:], strict=False):
        if facts[here].background:
            continue
        present = {item.name for item in facts[here].objects}
        later = {item.name: item for item in facts[after].objects}
        for item in facts[before].objects:
            other = later.get(item.name)
            if other is not None and item.name not in present and item.whole and other.whole and _alike(item, other):
                text = f"{item.name} is in the samples before and after, at nearly the same place, and not in this one"
                yield here, Reason("vanished", text, _VANISHED)


def _alike(one: ObjectFacts, other: ObjectFacts) -> bool:
    size = min(
        float(np.ptp(one.window.reshape(2, 2), axis=0).max()), float(np.ptp(other.window.reshape(2, 2), axis=0).max())
    )
    return float(np.abs(one.window - other.window).max()) < _STEADY_SHARE * size
