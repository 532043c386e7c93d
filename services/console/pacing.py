"""How fast and how large one viewer gets one view. Pure: the caller gives the time.

At most two pictures are under way; a further one goes when one was *drawn* (acknowledged). So the screen, the
browser and the network pace it, and nothing is ever queued.
"""

from __future__ import annotations

from dataclasses import dataclass, field

CREDITS = 2
LADDER = (1, 2, 4)
"""Sizes are exact parts of the source: halving is cheap, anything between costs 15 times as much."""
GIVE_UP_NS = 10_000_000_000
SLOW_NS, SLOW_FOR_NS = 150_000_000, 2_000_000_000
FAST_NS, FAST_FOR_NS = 60_000_000, 10_000_000_000
_SLOWEST_STEP = 5
"""On the lowest rung the time between two pictures doubles, from 66 ms at most to 2.1 s."""


def divisor_for(source_width: int, wished_width: int) -> int:
    """The smallest picture of the ladder that is at least as wide as wished, the full one at most."""
    return next((step for step in reversed(LADDER) if source_width // step >= wished_width), LADDER[0])


@dataclass
class Pacing:
    """The credits and the rung of one view of one viewer."""

    wished_width: int
    rungs_down: int = 0
    slower: int = 0
    under_way: dict[int, int] = field(default_factory=dict)
    _slow_since: int | None = None
    _fast_since: int | None = None
    _sent_ns: int = 0

    def ready(self, now_ns: int) -> bool:
        """Whether a picture may go now."""
        if len(self.under_way) >= CREDITS:
            return False
        return not self.slower or now_ns - self._sent_ns >= self._interval_ns()

    def stuck(self, now_ns: int) -> bool:
        """Whether nothing was acknowledged for 10 s: no pictures until the viewer speaks again."""
        return bool(self.under_way) and now_ns - min(self.under_way.values()) > GIVE_UP_NS

    def sent(self, seq: int, now_ns: int) -> None:
        """Picture ``seq`` was given to the connection."""
        self.under_way[seq] = now_ns
        self._sent_ns = now_ns

    def acknowledged(self, seq: int, now_ns: int) -> int | None:
        """Picture ``seq`` (and all before it) were drawn; how long it took in ns, None for an unknown one."""
        sent = self.under_way.get(seq)
        if sent is None:
            return None
        self.under_way = {other: at for other, at in self.under_way.items() if other > seq}
        took = now_ns - sent
        self._adapt(took, now_ns)
        return took

    def divisor(self, source_width: int) -> int:
        """Which part of the source's width the viewer gets now."""
        wished = LADDER.index(divisor_for(source_width, self.wished_width))
        return LADDER[min(wished + self.rungs_down, len(LADDER) - 1)]

    @property
    def reduced(self) -> bool:
        """Whether it gets less than it wished because its connection is slow."""
        return self.rungs_down > 0 or self.slower > 0

    def _adapt(self, took: int, now_ns: int) -> None:
        self._slow_since = None if took <= SLOW_NS else self._slow_since or now_ns
        self._fast_since = None if took >= FAST_NS else self._fast_since or now_ns
        if self._slow_since is not None and now_ns - self._slow_since >= SLOW_FOR_NS:
            self._slow_since = now_ns
            if self.rungs_down < len(LADDER) - 1:
                self.rungs_down += 1
            else:
                self.slower = min(self.slower + 1, _SLOWEST_STEP)
        elif self._fast_since is not None and now_ns - self._fast_since >= FAST_FOR_NS:
            self._fast_since = now_ns
            if self.slower:
                self.slower -= 1
            elif self.rungs_down:
                self.rungs_down -= 1

    def _interval_ns(self) -> int:
        return 33_000_000 << (self.slower + 1)
