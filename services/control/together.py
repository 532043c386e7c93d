"""`record` on several cameras: of each the frame nearest in time to the others'.

Control chooses the frames by when they were taken, and orders just these. What can't be had together (a camera that
gives no pictures, sees no object, or whose chosen frame is refused at the last) is asked of each camera by itself.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

from common import clock
from common.commands import RecordCommand
from common.ids import new_recording, sample_camera
from common.labels import PairLabel
from common.messages import Answer, ErrorInfo, RecordOrder
from services.control.conversations import Answers, Batch, Errand, Keys
from services.control.moments import Chosen, Moment
from services.control.stack import Stack

AFTER_TIMEOUT_S = 2.0
"""A label process answers at its own deadline; so much later control answers for it."""
AT_LEAST_S = 0.25
"""So long a label process has at least, so that it can say why it has no sample."""
RECENT_NS = 2_000_000_000
"""A camera of which no labelled frame was heard for so long is not waited for."""
ALL_FIT_SHARE = 0.5
"""For this share of the time it is waited for a moment at which all cameras' frames fit, then for those that can."""


@dataclass(slots=True)
class Outcome:
    """What became of a `record`: by camera what is stored and why not more, and what was taken together."""

    recordings: list[str] = field(default_factory=list)
    stored: dict[str, list[str]] = field(default_factory=dict)
    pending: set[str] = field(default_factory=set)
    failed: dict[str, ErrorInfo] = field(default_factory=dict)
    pairs: list[dict[str, Any]] = field(default_factory=list)

    def heard(self, camera: str, answer: Answer) -> None:
        """A label process's final answer."""
        self.stored.setdefault(camera, []).extend(answer.samples)
        self.pending.update(answer.pending)
        if answer.error is None:
            self.failed.pop(camera, None)
        else:
            self.failed[camera] = answer.error

    def taken_together(self, chosen: Chosen) -> None:
        """Keep which samples of a choice are durable, and how far apart in time they are."""
        kept = {
            camera: moment
            for camera, moment in sorted(chosen.moments.items())
            if moment.sample in self.stored.get(camera, ())
        }
        if len(kept) > 1:
            times = [moment.mono_ns for moment in kept.values()]
            samples = {camera: moment.sample for camera, moment in kept.items()}
            self.pairs.append({"spread_ms": round((max(times) - min(times)) / 1e6, 3), "samples": samples})


class Together:
    """Carries out one `record`; used as part of a conversation."""

    def __init__(self, stack: Stack, keys: Keys, command: RecordCommand) -> None:
        self._stack = stack
        self._keys = keys
        self._command = command
        self._began_ns = clock.monotonic_ns()
        self._outcome = Outcome()

    def run(self, cameras: Sequence[str]) -> Generator[Batch, Answers, Outcome]:
        """Record on all of them; returns when each camera has answered for all its samples."""
        if len(cameras) > 1:
            yield from self._rounds(self._stack.moments.recent(cameras, self._began_ns - RECENT_NS))
        lacking = {camera: self._lacking(camera) for camera in cameras}
        yield from self._order({camera: count for camera, count in lacking.items() if count})
        return self._outcome

    def _rounds(self, cameras: tuple[str, ...]) -> Generator[Batch, Answers, None]:
        """As many choices as samples are wanted, as long as there is one in time and it is stored."""
        since_ns = self._began_ns
        for _ in range(self._command.count):
            chosen = yield from self._choice(cameras, since_ns)
            if chosen is None:
                return
            yield from self._order(dict.fromkeys(chosen.moments, 1), chosen)
            self._outcome.taken_together(chosen)
            since_ns = max(chosen.at_ns + int(self._command.interval_s * 1e9), clock.monotonic_ns())

    def _choice(self, cameras: tuple[str, ...], since_ns: int) -> Generator[Batch, Answers, Chosen | None]:
        """Wait for frames that fit; those of all cameras at first, then of those of which any fits."""
        moments = self._stack.moments
        for wait_s in (self._left_s() * ALL_FIT_SHARE, self._left_s() * ALL_FIT_SHARE / 2):
            if len(cameras) < 2:
                return None
            among = cameras

            def ready(among: tuple[str, ...] = among) -> bool:
                return moments.chosen(among, since_ns, self._fits) is not None

            yield Batch((), wait_s, ready)
            chosen = moments.chosen(among, since_ns, self._fits)
            if chosen is not None:
                return chosen
            cameras = moments.fitting(among, since_ns, self._fits)
        return None

    def _fits(self, moment: Moment) -> bool:
        """Whether a frame's quick label lets expect that it is stored."""
        if self._command.background:
            return not moment.objects and not moment.missing
        config = self._stack.rig.config
        unsure = moment.ambiguous and config.pose.ambiguous == "refuse"
        lacks = moment.missing and config.record.incomplete == "refuse"
        return moment.objects > 0 and not unsure and not lacks

    def _order(self, counts: dict[str, int], chosen: Chosen | None = None) -> Generator[Batch, Answers, None]:
        """So many samples of each camera: of the chosen frames, or of the first that fit."""
        if not counts:
            return
        recording = new_recording(clock.wall_ns())
        self._outcome.recordings.append(recording)
        first = chosen is None and len(self._outcome.recordings) == 1
        timeout_s = self._command.timeout_s if first else self._left_s()
        since_ns = self._began_ns if first else clock.monotonic_ns()
        errands = tuple(
            Errand(
                self._stack.label_of(camera),
                RecordOrder(
                    key=self._keys.new("record"),
                    recording=recording,
                    camera=camera,
                    count=count,
                    interval_s=self._command.interval_s,
                    timeout_s=timeout_s,
                    since_mono_ns=since_ns,
                    frame=chosen.moments[camera].frame if chosen else self._command.frame,
                    background=self._command.background,
                    pair=_pair(chosen, camera),
                ),
            )
            for camera, count in counts.items()
        )
        answers = yield Batch(errands, timeout_s + AFTER_TIMEOUT_S)
        for camera, answer in zip(counts, answers, strict=True):
            self._outcome.heard(camera, answer)

    def _lacking(self, camera: str) -> int:
        pending = sum(sample_camera(name) == camera for name in self._outcome.pending)
        return self._command.count - len(self._outcome.stored.get(camera, ())) - pending

    def _left_s(self) -> float:
        passed_s = (clock.monotonic_ns() - self._began_ns) / 1e9
        return max(self._command.timeout_s - passed_s, AT_LEAST_S)


def _pair(chosen: Chosen | None, camera: str) -> PairLabel | None:
    return None if chosen is None else chosen.pair_of(camera)
