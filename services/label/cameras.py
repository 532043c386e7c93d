"""The cameras that this label process serves: their state, their ring, the frames that wait to be labelled."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterator
from contextlib import contextmanager

from common import clock
from common.errors import FrameLostError
from common.frames import FrameReader, FrameView
from common.geometry import CameraModel
from common.labels import SourceDetections
from common.messages import MARKERS, CameraState, Detections, FrameRef

_MARGIN = 3
"""Slots of the ring that are about to be overwritten count as gone."""
_TURNS = 3
_REMEMBERED = 16
GONE_AFTER_NS = 60_000_000_000
"""A camera whose process has said nothing for so long is gone for good; should it come back, it is a new one."""
HOLD_NS = 4_000_000_000
"""A paced camera gives up waiting for a label after 5 s."""


class Camera:
    """One camera as label sees it. ``labelled_ns`` is the moment of the newest frame that was labelled."""

    def __init__(self, state: CameraState, slots: int) -> None:
        self.name = state.camera.name
        self.state = state
        self.model = CameraModel.from_label(state.camera)
        self.waiting: deque[Detections] = deque()
        self.recent: deque[Detections] = deque(maxlen=slots)
        self.newest = 0
        self.labelled_ns = 0
        self.last_frame_ns = 0
        self._slots = slots
        self._turns_ns: deque[int] = deque(maxlen=_TURNS)
        self._reader: FrameReader | None = None
        self._heard_ns = clock.monotonic_ns()
        self._held_since_ns: int | None = None
        self._others: OrderedDict[tuple[str, int], dict[str, SourceDetections]] = OrderedDict()

    def update(self, state: CameraState) -> None:
        """Take over what the camera says of itself."""
        if state.camera != self.state.camera:
            self.model = CameraModel.from_label(state.camera)
        self.state = state
        self._heard_ns = clock.monotonic_ns()

    def gone(self, now_ns: int) -> bool:
        """Whether its process has fallen silent for good."""
        return now_ns - self._heard_ns > GONE_AFTER_NS

    def arrived(self, detections: Detections) -> None:
        """Queue the markers of a frame; keep another source's detections for the label of the same frame."""
        ref = detections.ref
        if detections.source == MARKERS:
            self.waiting.append(detections)
            self.newest = ref.frame
            self.last_frame_ns = clock.monotonic_ns()
            return
        known = self._others.setdefault((ref.boot, ref.frame), {})
        known[detections.source] = SourceDetections(source=detections.source, windows=detections.windows)
        while len(self._others) > _REMEMBERED:
            self._others.popitem(last=False)

    def others(self, ref: FrameRef) -> tuple[SourceDetections, ...]:
        """What other sources have said so far of this frame."""
        return tuple(self._others.get((ref.boot, ref.frame), {}).values())

    def alive(self, ref: FrameRef) -> bool:
        """Whether the frame will still be in the ring once it is labelled, as far as is known now.

        The camera goes on meanwhile, as it has since it was last heard of. Labelling takes as long as it did lately, at
        the least: one slow turn is no reason to give frames up.
        """
        ahead_ns = min(self._turns_ns, default=0)
        if not self.state.paced:
            ahead_ns += clock.monotonic_ns() - self.last_frame_ns
        return self.newest - ref.frame + int(ahead_ns * self.state.fps / 1e9) < self._slots - _MARGIN

    @contextmanager
    def turn(self) -> Iterator[Detections]:
        """Take the frame that waits longest; its labelling is the block."""
        began_ns = clock.monotonic_ns()
        detections = self.waiting.popleft()
        self.recent.append(detections)
        yield detections
        self._turns_ns.append(clock.monotonic_ns() - began_ns)

    def moment(self, ref: FrameRef) -> int | None:
        """When in its stream the frame was taken (ns); None where a frame says nothing about the next.

        A video has its own time, however fast it is played. Pictures of a folder were not taken one after the other
        at the rate at which they are read.
        """
        return ref.device_ns if self.state.driver == "files" else ref.captured_mono_ns

    @contextmanager
    def pixels(self, ref: FrameRef) -> Iterator[FrameView]:
        """The frame's pixels in the ring; FrameLostError if it was overwritten meanwhile or its ring is gone."""
        if self._reader is None or self._reader.name != ref.ring:
            self.close()
            try:
                self._reader = FrameReader(ref.ring)
            except FileNotFoundError as error:
                raise FrameLostError(f"the ring {ref.ring} of {self.name} is gone") from error
        with self._reader.view(ref.frame) as view:
            yield view

    def hold(self, wish: bool) -> bool:
        """Whether its next frame is held back: as long as that is wished, but a single frame never for too long."""
        now = clock.monotonic_ns()
        if not wish:
            self._held_since_ns = None
            return False
        if self._held_since_ns is None:
            self._held_since_ns = now
        if now - self._held_since_ns < HOLD_NS:
            return True
        self._held_since_ns = None
        return False

    def close(self) -> None:
        """Unmap the ring."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
