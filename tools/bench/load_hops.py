"""Where the time of a frame goes between its capture and its published label, from what the services say on the bus.

Each message carries when it was sent, and a stage's result how long it took. So a frame's way falls into the hops of
``HOPS``, which add up to its latency; packing a message counts to the hop after it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np

from common.messages import FrameRef

HOPS = ("capture", "to detect", "detect", "to label", "label")
"""Copying into the ring, and the news of it; waiting for detect and the bus; detect's work; the same of label."""
_UNDER_WAY = 1000

_Key = tuple[str, str, int]
V = TypeVar("V")


@dataclass(frozen=True)
class Hop:
    """What one hop takes (ms): of all frames, and the mean of those slowest 1 % whose whole way took longest."""

    p50_ms: float
    p99_ms: float
    mean_ms: float
    slowest_mean_ms: float


class FrameHops:
    """Puts the messages of one frame together; frames of which a message was missed are left out."""

    def __init__(self) -> None:
        self._announced: OrderedDict[_Key, int] = OrderedDict()
        self._detected: OrderedDict[_Key, tuple[int, int]] = OrderedDict()
        self._ways: list[tuple[int, ...]] = []

    def announced(self, ref: FrameRef, sent_ns: int) -> None:
        """Capture has told of a frame."""
        _keep(self._announced, _key(ref), sent_ns)

    def detected(self, ref: FrameRef, sent_ns: int, took_ns: int) -> None:
        """Detect has told what it saw, after ``took_ns`` of work."""
        _keep(self._detected, _key(ref), (sent_ns, took_ns))

    def labelled(self, ref: FrameRef, sent_ns: int, took_ns: int) -> None:
        """Label has told of it: the frame's way is at its end."""
        announced = self._announced.pop(_key(ref), None)
        detected = self._detected.pop(_key(ref), None)
        if announced is None or detected is None:
            return
        seen_ns, search_ns = detected
        moments = (ref.captured_mono_ns, announced, seen_ns - search_ns, seen_ns, sent_ns - took_ns, sent_ns)
        self._ways.append(tuple(later - earlier for earlier, later in pairwise(moments)))

    def result(self) -> dict[str, Hop]:
        """By hop, in the order of the way; empty before the first whole way."""
        return {} if not self._ways else _hops(self._ways)


def _hops(ways: Sequence[tuple[int, ...]]) -> dict[str, Hop]:
    table = np.array(ways, dtype=np.float64) / 1e6
    whole = table.sum(axis=1)
    slowest = table[np.argsort(whole)[-max(1, len(whole) // 100) :]].mean(axis=0)
    median, late = np.percentile(table, (50, 99), axis=0)
    columns = zip(HOPS, median, late, table.mean(axis=0), slowest, strict=True)
    return {name: Hop(*(round(float(value), 2) for value in values)) for name, *values in columns}


def _key(ref: FrameRef) -> _Key:
    return ref.camera, ref.boot, ref.frame


def _keep(kept: OrderedDict[_Key, V], key: _Key, value: V) -> None:
    kept[key] = value
    while len(kept) > _UNDER_WAY:
        kept.popitem(last=False)
