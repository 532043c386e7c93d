"""The pictures of a camera that runs, out of its ring: the newest, or the one nearest to a time."""

from __future__ import annotations

from collections import deque
from typing import Self

import numpy as np
from numpy.typing import NDArray

from common import clock
from common.bus import Endpoints, Poller, Subscriber
from common.errors import FrameLostError, RefusedError
from common.frames import FrameReader
from common.messages import CameraState, FrameAnnounced, FrameRef
from common.topics import CAMERA, FRAME

Colour = NDArray[np.uint8]
SILENT_S = 20.0
"""A camera that gives no picture for so long won't give another without somebody's help."""
_KEPT = 8


class Feed:
    """Hears one camera. Nothing of it is changed or held up."""

    def __init__(self, endpoints: Endpoints, name: str) -> None:
        self.name = name
        self.state: CameraState | None = None
        self._recent: deque[FrameRef] = deque(maxlen=_KEPT)
        self._reader: FrameReader | None = None
        self._heard_ns = clock.monotonic_ns()
        self._subscriber = Subscriber(endpoints)
        for topic in (FRAME, CAMERA):
            self._subscriber.subscribe(topic, name)
        self._poller = Poller(self._subscriber)

    def listen(self, timeout_s: float) -> None:
        """Take what is announced, waiting for it for ``timeout_s``. Raises RefusedError for a camera that is silent."""
        self._poller.wait(timeout_s)
        for received in self._subscriber.receive():
            message = received.message
            if isinstance(message, FrameAnnounced):
                self._recent.append(message.ref)
                self._heard_ns = clock.monotonic_ns()
            elif isinstance(message, CameraState):
                self.state = message
                if message.phase == "waiting" and self._recent:
                    raise RefusedError(
                        f"camera {self.name} plays files for recordings only; calibrate from them with --images or "
                        "--video, or give it `loop: true`",
                        code="no_camera",
                    )
        if clock.monotonic_ns() - self._heard_ns > SILENT_S * 1e9:
            raise RefusedError(self._silence(), code="no_camera")

    def newest(self) -> FrameRef | None:
        """The frame announced last."""
        return self._recent[-1] if self._recent else None

    def nearest(self, mono_ns: int) -> FrameRef | None:
        """Of the newest frames the one that was taken nearest to a time."""
        return min(self._recent, key=lambda ref: abs(ref.captured_mono_ns - mono_ns), default=None)

    def read(self, ref: FrameRef) -> Colour | None:
        """A copy (H, W, 3) of a frame's picture; None if it was overwritten, or its ring is gone."""
        try:
            if self._reader is None or self._reader.name != ref.ring:
                self._close_ring()
                self._reader = FrameReader(ref.ring)
            with self._reader.view(ref.frame) as view:
                return view.bgr.copy()
        except (FrameLostError, FileNotFoundError):
            return None

    def close(self) -> None:
        """Let go of bus and ring. May be called again."""
        self._close_ring()
        self._subscriber.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _silence(self) -> str:
        state = self.state
        if state is None:
            return f"nothing is heard of camera {self.name}: is its capture process running? `tagmill status` shows it"
        reason = f": {state.last_error}" if state.last_error else ""
        return f"no picture came from camera {self.name} for {SILENT_S:g} s, it is {state.phase}{reason}"

    def _close_ring(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None
