"""Which label belongs to which picture. Pure: the caller gives the time.

A frame is drawn when its label has come, at most 120 ms after it was taken without one, and never with another's.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass

from common.messages import FrameRef, Labels

WAIT_NS = 120_000_000
SILENT_NS = 1_000_000_000
"""When no label has come for so long, no frame waits for one."""
_KEPT = 64


@dataclass(frozen=True, slots=True)
class Joined:
    """A frame with its label, or without one (``labels`` None)."""

    ref: FrameRef
    labels: Labels | None


class Join:
    """One camera's frames and labels; ``late`` counts labels whose frame had been drawn without them."""

    def __init__(self) -> None:
        self.late = 0
        self._boot = ""
        self._drawn = 0
        self._waiting: deque[FrameRef] = deque(maxlen=_KEPT)
        self._known: OrderedDict[tuple[str, int], Labels] = OrderedDict()
        self._labels_ns: int | None = None

    def labels(self, labels: Labels, now_ns: int) -> Joined | None:
        """A label came: its frame with it, unless that frame or a later one has been drawn."""
        ref = labels.ref
        self._labels_ns = now_ns
        self._known[ref.boot, ref.frame] = labels
        while len(self._known) > _KEPT:
            self._known.popitem(last=False)
        if not self._is_next(ref):
            self.late += 1
            return None
        return self._draw(Joined(ref, labels))

    def frame(self, ref: FrameRef, now_ns: int) -> Joined | None:
        """A frame was announced: drawn at once where labels don't come at all."""
        if not self._is_next(ref):
            return None
        if (ref.boot, ref.frame) in self._known:
            return self._draw(Joined(ref, self._known[ref.boot, ref.frame]))
        if self.silent(now_ns):
            return self._draw(Joined(ref, None))
        self._waiting.append(ref)
        return None

    def due(self, now_ns: int) -> Joined | None:
        """The newest frame that has waited long enough for its label."""
        late = [ref for ref in self._waiting if now_ns - ref.captured_mono_ns >= WAIT_NS and self._is_next(ref)]
        return self._draw(Joined(late[-1], None)) if late else None

    def next_due_ns(self) -> int | None:
        """When ``due`` has something, None while no frame waits."""
        return self._waiting[0].captured_mono_ns + WAIT_NS if self._waiting else None

    def of(self, ref: FrameRef) -> Labels | None:
        """The label of a frame that was seen lately (an erased picture comes later than its label)."""
        return self._known.get((ref.boot, ref.frame))

    def silent(self, now_ns: int) -> bool:
        """Whether no labels come at present."""
        return self._labels_ns is None or now_ns - self._labels_ns > SILENT_NS

    def _is_next(self, ref: FrameRef) -> bool:
        return ref.boot != self._boot or ref.frame > self._drawn

    def _draw(self, joined: Joined) -> Joined:
        self._boot, self._drawn = joined.ref.boot, joined.ref.frame
        self._waiting = deque((ref for ref in self._waiting if self._is_next(ref)), maxlen=_KEPT)
        return joined
