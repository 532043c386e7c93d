"""The camera's one mouth: its state and its frames, published in one order.

The grab thread announces frames and changes of state, the main loop repeats the state once a second. Both go
through one publisher under one lock, so that a subscriber never hears of a frame before the state that describes
it, nor of an older state after a newer one.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

from common import clock
from common.bus import Publisher
from common.labels import CameraLabel
from common.messages import CameraState, FrameAnnounced, FrameRef, TrueObject, Truth, Warned
from common.messages.frames import CameraPhase
from common.service.context import Report
from common.service.meters import Rate, Tally
from common.topics import CAMERA, FRAME, TRUTH
from services.capture.cameras.base import Description

REPEAT_NS = 1_000_000_000

NEXT_PHASES: dict[CameraPhase, frozenset[CameraPhase]] = {
    "opening": frozenset({"streaming", "waiting", "lost"}),
    "waiting": frozenset({"streaming", "lost"}),
    "streaming": frozenset({"waiting", "ended", "lost", "stalled"}),
    "ended": frozenset({"streaming", "lost"}),
    "stalled": frozenset({"streaming", "waiting", "ended", "lost"}),
    "lost": frozenset({"streaming", "waiting", "ended"}),
}
"""Which phase may follow which; a phase may also be entered again."""


_FAULTS = ("lost", "stalled")


@dataclass(frozen=True, slots=True)
class Pass:
    """One playing of a file camera: for which recording, from which count on."""

    recording: str
    first: int


class Announcer:
    """Publishes FRAME, TRUTH and CAMERA of one camera in one life; usable from several threads.

    ``unopened`` stands in for the camera's description until it was opened for the first time.
    """

    def __init__(self, publisher: Publisher, boot: str, driver: str, unopened: CameraLabel, fps: float) -> None:
        self._publisher = publisher
        self._boot = boot
        self._driver = driver
        self._name = unopened.name
        self._guard = threading.Lock()
        self._description = Description(unopened, fps)
        self._opened = False
        self._ring = ""
        self._phase: CameraPhase = "opening"
        self._captured = 0
        self._newest_ns = 0
        self._lost = Tally()
        self._last_error: str | None = None
        self._pass: Pass | None = None
        self._rate = Rate()
        self._warned: tuple[Warned, ...] = ()
        self._repeat_at_ns = 0

    @property
    def captured(self) -> int:
        """The count of the newest captured frame; previews don't count."""
        return self._captured

    @property
    def unpaced(self) -> bool:
        """Whether the camera was opened and doesn't wait for its labels: then nobody here needs them."""
        return self._opened and not self._description.paced

    @property
    def phase(self) -> CameraPhase:
        """The present phase."""
        return self._phase

    def enter(self, phase: CameraPhase, error: str | None = None) -> None:
        """Change the phase and publish it; raises ValueError for a change that NEXT_PHASES doesn't have.

        The last error stays known until there is a newer one, or the camera that was lost is back.
        """
        with self._guard:
            if phase != self._phase and phase not in NEXT_PHASES[self._phase]:
                raise ValueError(f"camera {self._name}: {phase} does not follow {self._phase}")
            if error is not None or self._phase in _FAULTS:
                self._last_error = error
            self._phase = phase
            self._publish_state()

    def stall(self, error: str) -> bool:
        """Enter ``stalled`` if the camera streams (the grab thread may just have changed that); whether it does now."""
        with self._guard:
            if self._phase == "streaming":
                self._phase, self._last_error = "stalled", error
                self._lost.add("stalled")
                self._publish_state()
                return True
            return False

    def describe(self, description: Description, ring: str) -> None:
        """Publish what the camera says of itself, before the first frame for which it holds."""
        with self._guard:
            if description.warnings != self._description.warnings:
                now = clock.wall_ns()
                self._warned = tuple(Warned(wall_ns=now, code="camera", message=text) for text in description.warnings)
            self._description, self._opened = description, True
            self._ring = ring
            self._publish_state()

    def play(self, recording: str) -> None:
        """A file camera begins at frame 0 for this recording; enters ``streaming``."""
        with self._guard:
            self._pass = Pass(recording, self._captured + 1)
        self.enter("streaming")

    def frame(self, ref: FrameRef, truth: tuple[TrueObject, ...] | None) -> None:
        """Announce a frame that is in the ring."""
        with self._guard:
            self._newest_ns = ref.captured_mono_ns
            if not ref.preview:
                self._captured = ref.count
                self._rate.mark()
            self._publisher.publish(FRAME, (self._name,), FrameAnnounced(ref=ref))
            if truth is not None:
                told = Truth(camera=self._name, boot=self._boot, frame=ref.frame, objects=truth)
                self._publisher.publish(TRUTH, (self._name,), told)

    def lose(self, reason: str, error: str | None = None, *, count: int = 1) -> None:
        """Count something that was lost; told with the next state."""
        with self._guard:
            self._lost.add(reason, count)
            if error is not None:
                self._last_error = error

    def repeat(self) -> None:
        """Publish the state again if the last time is a second ago."""
        with self._guard:
            if clock.monotonic_ns() >= self._repeat_at_ns:
                self._publish_state()

    def report(self) -> Report:
        """For the service's heartbeat."""
        with self._guard:
            dropped = self._lost.as_dict()
            if self._publisher.dropped:
                dropped["announce"] = self._publisher.dropped
            return Report(
                cameras=(self._name,),
                rates={"captured": self._rate.per_second()},
                dropped=dropped,
                numbers={"captured": float(self._captured)},
                last_error=self._last_error,
                faulty=self._phase in _FAULTS,
                warnings=self._warned,
            )

    def _publish_state(self) -> None:
        self._repeat_at_ns = clock.monotonic_ns() + REPEAT_NS
        state = CameraState(
            boot=self._boot,
            phase=self._phase,
            driver=self._driver,
            ring=self._ring,
            camera=self._description.camera,
            fps=self._description.fps,
            depth_unit_mm=self._description.depth_unit_mm,
            captured=self._captured,
            lost=self._lost.as_dict(),
            last_error=self._last_error,
            played_for=self._pass.recording if self._pass else None,
            play_first=self._pass.first if self._pass else 0,
            paced=self._description.paced,
            newest_mono_ns=self._newest_ns,
        )
        self._publisher.publish(CAMERA, (self._name,), state)
