"""What was asked to be recorded: single requests (`record`) and recordings (`start`), and which frame they want."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from common import clock
from common.ledgers import Ledger, RecordingPhase, RecordingSpec
from common.messages import MARKERS, Answer, ErrorInfo, FrameRef, RecordOrder, SampleItem
from services.label.account import Account

NOT_DUE = "not_due"
NOT_ASKED = "not_asked"
_REASONS = {
    "no_object": "no configured object is in view; turn a side with a marker towards the camera",
    "ambiguous_pose": "two poses fit equally well; turn the object by 5 degrees (a marker that faces the camera "
    "squarely is the worst case), show a second marker or come nearer",
    "incomplete": "an object in view has no pose; hold still or show one of its markers",
    "object_in_view": "a background sample was asked for, but an object is in view; take it out of the picture",
    "frame_gone": "that frame is no longer in the ring; ask for a newer one or leave `frame` out",
    "frame_lost": "the frame was overwritten before it could be kept; the machine is too slow for this rate",
    "thinned": "samples come faster than they can be stored; frames are left out evenly until the backlog is gone",
    "backlog_full": "all sample slots wait for the disk; record slower or wait until the backlog is gone",
    "store_down": "saving is stopped because the store doesn't answer; it is restarted by itself, try again",
    "no_frame": "no picture came from the camera; see `tagmill status` for what is wrong with it",
    "no_space": "shared memory is too small for another sample ring; free some of /dev/shm or lower ring.samples",
}


def explain(reason: str) -> str:
    """One sentence for a reason code."""
    return _REASONS.get(reason, reason.replace("_", " "))


@dataclass(eq=False)
class Request:
    """A `record` order: up to ``count`` fitting frames before the deadline; one candidate at a time.

    ``held``: it takes no frame until the store has said what an earlier life of this process recorded for it.
    """

    order: RecordOrder
    deadline_ns: int
    started_at: str
    account: Account = field(default_factory=Account)
    samples: list[str] = field(default_factory=list)
    last_reason: str = "no_frame"
    last_message: str | None = None
    spoilt: ErrorInfo | None = None
    """Why the last sample that came to an end was none; a sample that is stored clears it."""
    next_due_ns: int = 0
    answered: bool = False
    held: bool = False

    @classmethod
    def of(cls, order: RecordOrder) -> Request:
        """A new request; its time runs from when the order was given."""
        begin = order.since_mono_ns or clock.monotonic_ns()
        return cls(order, begin + int(order.timeout_s * 1e9), clock.iso_utc(clock.wall_ns()))

    @property
    def camera(self) -> str:
        """The camera it asks for."""
        return self.order.camera

    @property
    def recording(self) -> str:
        """The recording's id, given by whoever asked."""
        return self.order.recording

    @property
    def background(self) -> bool:
        """Whether pictures without an object are wanted."""
        return self.order.background

    @property
    def done(self) -> bool:
        """All samples are durable."""
        return len(self.samples) >= self.order.count

    @property
    def over(self) -> bool:
        """Nothing more can come of it."""
        return self.answered and not self.account.pending

    def wants(self, ref: FrameRef) -> str | None:
        """None if this frame is wanted now, else why not."""
        if self.answered or self.held or self.account.pending or self.done:
            return NOT_ASKED
        if self.order.frame is not None:
            return None if ref.frame == self.order.frame else NOT_ASKED
        if ref.captured_mono_ns < self.order.since_mono_ns:
            return NOT_ASKED
        return None if ref.captured_mono_ns >= self.next_due_ns else NOT_DUE

    def resume(self, found: Iterable[SampleItem]) -> None:
        """The samples that are durable already, of an earlier life of this process; go on with what lacks."""
        self.held = False
        for item in sorted(found, key=lambda item: item.name):
            self.account.looked_at(MARKERS, counted=False)
            self.account.ordered(item.name)
            self.stored(item.name)
            age_ns = clock.wall_ns() - clock.wall_of(item.captured_at)
            self.next_due_ns = clock.monotonic_ns() - age_ns + int(self.order.interval_s * 1e9)

    def refused(self, reason: str, message: str | None = None) -> None:
        """A wanted frame did not fit."""
        self.account.refuse(reason)
        self.last_reason, self.last_message = reason, message
        if self.order.frame is not None:
            self.deadline_ns = 0

    def refused_late(self, reason: str, message: str) -> None:
        """Nothing more is looked at; the reason goes into the answer."""
        self.last_reason, self.last_message = reason, message
        self.deadline_ns = 0

    def lost(self) -> None:
        """A wanted frame was overwritten before it could be kept."""
        self.account.drop("label")
        self.last_reason, self.last_message = "frame_lost", None
        if self.order.frame is not None:
            self.deadline_ns = 0

    def stored(self, sample: str) -> None:
        """A sample is durable."""
        self.account.stored(sample)
        self.samples.append(sample)
        self.spoilt = None

    def failed(self, sample: str, reason: str, message: str | None) -> None:
        """A sample was refused on its way."""
        self.account.failed(sample, reason)
        self.last_reason, self.last_message = reason, message
        self.spoilt = ErrorInfo(code=reason, message=message or explain(reason))
        if self.order.frame is not None:
            self.deadline_ns = 0

    def taken(self, ref: FrameRef) -> None:
        """A frame is on its way."""
        self.next_due_ns = ref.captured_mono_ns + int(self.order.interval_s * 1e9)

    def final(self) -> Answer:
        """The answer as of now."""
        self.answered = True
        pending = tuple(sorted(self.account.pending))
        if self.done:
            return Answer(key=self.order.key, samples=tuple(self.samples))
        if self.held and self.last_reason == "no_frame":
            self.last_reason, self.last_message = "store_down", None
        if pending:
            error = self._unfinished(len(pending))
        else:
            error = ErrorInfo(code=self.last_reason, message=self.last_message or explain(self.last_reason))
        return Answer(key=self.order.key, samples=tuple(self.samples), pending=pending, error=error)

    def _unfinished(self, pending: int) -> ErrorInfo:
        """Why not all is durable while samples are still under way."""
        stopping = self.last_reason == "stopping"
        when = "when tagmill was stopped" if stopping else f"after {self.order.timeout_s:g} s"
        if self.spoilt is not None and not stopping:
            # The one under way will most likely go the way of those before: say what is wrong, not that time is up.
            words = f"{self.spoilt.message}; {pending} more under way {when}, the ledger will say what becomes of it"
            return ErrorInfo(code=self.spoilt.code, message=words)
        words = f"{pending} sample(s) were not durable {when}; they are kept and the ledger will settle them"
        return ErrorInfo(code="stopping" if stopping else "timeout", message=words)

    def spec(self) -> RecordingSpec:
        """As an entry of the ledger."""
        return RecordingSpec(
            recording=self.recording,
            mode="record",
            cameras=(self.camera,),
            every_s=self.order.interval_s,
            until_count=self.order.count,
            background=self.order.background,
            started_at=self.started_at,
            spread_ms=None if self.order.pair is None else self.order.pair.spread_ms,
        )


@dataclass(eq=False)
class Recording:
    """A recording on one camera between `start` and its end."""

    spec: RecordingSpec
    camera: str
    account: Account = field(default_factory=Account)
    phase: RecordingPhase = "running"
    why: str | None = None
    ended_at: str | None = None
    waiting_for: str | None = None
    next_due_ns: int = 0
    ended_seen_ns: int | None = None

    @property
    def recording(self) -> str:
        """Its id."""
        return self.spec.recording

    @property
    def background(self) -> bool:
        """Whether pictures without an object are wanted."""
        return self.spec.background

    def wants(self, ref: FrameRef) -> str | None:
        """None if this frame is wanted, else why not."""
        if self.phase != "running":
            return NOT_ASKED
        until = self.spec.until_count
        if until is not None and self.account.recorded + len(self.account.pending) >= until:
            return NOT_DUE
        return None if ref.captured_mono_ns >= self.next_due_ns else NOT_DUE

    def refused(self, reason: str, message: str | None = None) -> None:  # noqa: ARG002 - same shape as Request's
        """A wanted frame did not fit."""
        self.account.refuse(reason)
        self.waiting_for = reason

    def lost(self) -> None:
        """A wanted frame was overwritten before it could be kept."""
        self.account.drop("label")

    def stored(self, sample: str) -> None:
        """A sample is durable."""
        self.account.stored(sample)

    def failed(self, sample: str, reason: str, message: str | None) -> None:  # noqa: ARG002 - as Request's
        """A sample was refused on its way."""
        self.account.failed(sample, reason)
        self.waiting_for = reason

    def taken(self, ref: FrameRef) -> None:
        """A frame is on its way. The next is due on the grid of ``every_s``, whatever this one's delay was."""
        self.waiting_for = None
        step = int(self.spec.every_s * 1e9)
        if step:
            late = ref.captured_mono_ns - self.next_due_ns
            self.next_due_ns = ref.captured_mono_ns + step if late >= step else self.next_due_ns + step

    @property
    def full(self) -> bool:
        """``until_count`` samples are durable."""
        return self.spec.until_count is not None and self.account.recorded >= self.spec.until_count

    def finish(self, why: str) -> None:
        """Take no further frame; it ends when nothing is pending."""
        if self.phase == "running":
            self.phase, self.why = "finishing", why
            self.account.gaps.finish(clock.monotonic_ns(), clock.wall_ns())

    def ledger(self) -> Ledger:
        """This camera's part of the recording's ledger."""
        return Ledger(
            spec=self.spec,
            phase=self.phase,
            ended_at=self.ended_at,
            why=self.why,
            cameras={self.camera: self.account.ledger()},
        )
