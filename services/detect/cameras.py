"""The cameras that detect knows: the frames that wait, the ring they lie in, and what was passed over."""

from __future__ import annotations

from collections import deque
from typing import Literal

import cv2
import numpy as np

from common.errors import FrameLostError
from common.frames import FrameReader
from common.messages import CameraState, FrameRef
from common.service.meters import Rate, Tally
from services.detect.markers.base import Grey

Reason = Literal["superseded", "stale", "frame_lost"]

GONE_AFTER_NS = 5_000_000_000
"""A camera that has said nothing for so long is gone: its ring is unmapped."""
SHORTEST_HISTORY_NS = 500_000_000
MOST_WAITING = 5
"""Frames of a recorded camera that wait: a sixth of a second at 30/s. With one more only the newest is left."""
_RECORDED_NS = 3_000_000_000
"""A recording that has told nothing for so long has ended with its label process; it tells once a second."""


class Camera:
    """One camera as detect sees it.

    Of the frames that wait only the newest is taken: a live picture is worth most when it is fresh. While a recording
    runs each is wanted, so they wait their turn, unless detect falls behind for longer than a moment.

    ``skipped`` counts, for as long as this process lives, the captured frames that gave no detections:
    ``superseded`` by a newer one (here, in a queue, or lost on the bus), ``stale`` (older than the ring's
    history when it came) or ``frame_lost`` (overwritten while it was read, or its ring gone).
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: CameraState | None = None
        self.skipped = Tally()
        self.rate = Rate()
        self._waiting: deque[FrameRef] = deque()
        self._recorded_ns = -_RECORDED_NS
        self._boot = ""
        self._last_frame = 0
        self._last_count = 0
        self._heard_ns = 0
        self._reader: FrameReader | None = None
        self._grey: Grey | None = None

    @property
    def ready(self) -> bool:
        """Whether a frame waits and the camera has said what it is."""
        return bool(self._waiting) and self.state is not None

    @property
    def patient(self) -> bool:
        """Whether it gives pictures of a file and waits for each one's label: there is time to look closely."""
        return self.state is not None and self.state.paced and self.state.driver == "files"

    def heard(self, state: CameraState, now_ns: int) -> None:
        """Take over what the camera says of itself; an outdated ring is unmapped."""
        self.state = state
        self._heard_ns = now_ns
        if self._reader is not None and self._reader.name != state.ring:
            self.unmap()

    def announced(self, ref: FrameRef, now_ns: int) -> None:
        """A frame is in the ring; it takes the place of those that still wait, but for a recorded camera's."""
        self._heard_ns = now_ns
        newest = self._waiting[-1] if self._waiting else None
        if self._boot == ref.boot and ref.frame <= self._last_frame:
            return
        if newest is None or newest.boot != ref.boot or newest.frame < ref.frame:
            recorded = now_ns - self._recorded_ns < _RECORDED_NS
            if newest is None or newest.boot != ref.boot or not recorded or len(self._waiting) == MOST_WAITING:
                self._waiting.clear()
            self._waiting.append(ref)

    def recorded(self, running: bool, now_ns: int) -> None:
        """What a recording on this camera says of itself."""
        self._recorded_ns = now_ns if running else -_RECORDED_NS

    def next(self, now_ns: int, slots: int) -> FrameRef | None:
        """Take the first frame that waits; None if it is stale. ``slots`` is the ring's length as configured."""
        if not self._waiting:
            return None
        ref = self._waiting.popleft()
        self._account(ref)
        if now_ns - ref.captured_mono_ns > self._history_ns(ref, slots):
            self._skip(ref, "stale")
            return None
        return ref

    def grey(self, ref: FrameRef) -> Grey | None:
        """The frame as a grey picture (H, W), valid until the next call; None, and counted, if it is lost."""
        try:
            if self._reader is None or self._reader.name != ref.ring:
                self.unmap()
                self._reader = FrameReader(ref.ring)
            with self._reader.view(ref.frame) as view:
                grey = cv2.cvtColor(view.bgr, cv2.COLOR_BGR2GRAY, self._grey_buffer(view.bgr.shape))
        except FrameLostError:
            # Perhaps its owner died and the mapping is all that is left of the ring: look it up anew next time.
            self.unmap()
            self._skip(ref, "frame_lost")
            return None
        return np.asarray(grey, dtype=np.uint8)

    def gone(self, now_ns: int) -> bool:
        """Whether the camera has fallen silent."""
        return now_ns - self._heard_ns > GONE_AFTER_NS

    def forget(self) -> None:
        """The camera vanished: keep only its account."""
        self.state = None
        self._waiting.clear()
        self._grey = None
        self.unmap()

    def handed_over(self) -> None:
        """Another instance serves it: the frames from here on are not ours to account for."""
        self._boot = ""
        self.unmap()

    def unmap(self) -> None:
        """Let go of the ring. May be called again."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def _account(self, ref: FrameRef) -> None:
        """Count the captured frames between the last one taken and this one."""
        if ref.boot != self._boot:
            # Of the first life that is seen, frames before the first don't count: they were before our time.
            self._last_count = 0 if self._boot else max(ref.count - 1, 0)
            self._boot = ref.boot
        if not ref.preview:
            passed_over = ref.count - self._last_count - 1
            if passed_over > 0:
                self.skipped.add("superseded", passed_over)
            self._last_count = ref.count
        self._last_frame = ref.frame

    def _skip(self, ref: FrameRef, reason: Reason) -> None:
        if not ref.preview:
            self.skipped.add(reason)

    def _history_ns(self, ref: FrameRef, slots: int) -> float:
        """How long a frame lives in the ring; without end where the camera doesn't go on by itself."""
        if self.state is None or self.state.paced or ref.preview:
            return float("inf")
        return max(slots / self.state.fps * 1e9, SHORTEST_HISTORY_NS)

    def _grey_buffer(self, shape: tuple[int, ...]) -> Grey:
        if self._grey is None or self._grey.shape != shape[:2]:
            self._grey = np.empty(shape[:2], dtype=np.uint8)
        return self._grey
