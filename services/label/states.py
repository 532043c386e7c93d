"""What the label process says of itself: its recordings' states, its pace."""

from __future__ import annotations

from common import clock
from common.bus import Publisher
from common.laps import Laps, StepMeans
from common.service.meters import Percentiles, Rate
from common.topics import RECORDING
from services.label.recorder import Recorder

_EVERY_NS = 1_000_000_000
_JUDGING_EVERY_NS = 200_000_000


class States:
    """RECORDING once a second, five times while a recording chooses its views, and at once when a phase has changed."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._due_ns = 0
        self._phases: dict[tuple[str, str], str] = {}

    def hurry(self) -> None:
        """Tell at the next opportunity."""
        self._due_ns = 0

    def tell(self, recorder: Recorder) -> None:
        """Publish what is due."""
        now = clock.monotonic_ns()
        phases = {key: item.phase for key, item in recorder.recordings.items()}
        if now < self._due_ns and phases == self._phases:
            return
        every_ns = _JUDGING_EVERY_NS if recorder.judging else _EVERY_NS
        self._due_ns, self._phases = now + every_ns, dict(phases)
        for state in recorder.states():
            self._publisher.publish(RECORDING, (state.camera, state.ledger.spec.recording), state)


class Pace:
    """How many frames are labelled a second, and how long after their capture."""

    def __init__(self) -> None:
        self.labelled = Rate()
        self._latency = Percentiles()
        self._steps = StepMeans()

    def mark(self, latency_ns: int, laps: Laps) -> None:
        """A frame was labelled, so long after its capture; ``laps`` are what that took."""
        self.labelled.mark()
        self._latency.add(latency_ns)
        self._steps.add(laps)

    def numbers(self) -> dict[str, float]:
        """Percentiles of the latency, and what live labelling takes, by name; empty before the first frame."""
        if not len(self._latency):
            return {}
        latency = {f"latency_p{percent}_ms": self._latency.at(percent) / 1e6 for percent in (50, 99)}
        return latency | self._steps.as_numbers()
