"""The account of one recording on one camera: every captured frame ends as recorded, refused or dropped. Pure."""

from __future__ import annotations

from collections import Counter
from typing import Literal

from common.ledgers import CameraLedger
from common.messages import CameraState, FrameRef
from services.label.gaps import Gaps

Place = Literal["detect", "label", "label_restart"]


class Account:
    """Counts for one camera of one recording.

    Frames are known by their ``count`` in one life (boot) of the capture process. A jump in the count is
    frames for which no detections came (place ``detect``); so nothing goes missing between two stages.
    An account that is ``resumed`` after a crash of the label process takes the store's word for what became
    durable; at the first frame all that is then still open counts as lost at ``label_restart``.
    """

    def __init__(self, resumed: CameraLedger | None = None) -> None:
        known = resumed or CameraLedger()
        self.captured = known.captured
        self.labelled = known.labelled
        self.recorded = known.recorded
        self.detected: Counter[str] = Counter(known.detected)
        self.refused: Counter[str] = Counter(known.refused)
        self.dropped: Counter[str] = Counter(known.dropped)
        self.pending: set[str] = set()
        self.gaps = Gaps(known)
        self._boot = known.boot
        self._last = known.last_count
        self._first_of_pass: int | None = None
        self._resumed = resumed is not None

    def arrived(self, ref: FrameRef) -> bool:
        """A frame's detections came; False if the frame was accounted for already (or is a preview)."""
        if ref.preview or (ref.boot == self._boot and ref.count <= self._last):
            return False
        if ref.boot == self._boot:
            jump = ref.count - self._last
        elif self._boot:
            jump = ref.count
            self._first_of_pass = None
        else:
            jump = 1
            self._first_of_pass = ref.count
        self._boot, self._last = ref.boot, ref.count
        self.gaps.frame(ref, jump - 1)
        self.captured += jump
        if self._resumed:
            self._resumed = False
            self._drop("label_restart", self._unaccounted() - 1)
        else:
            self._drop("detect", jump - 1)
        return True

    def _unaccounted(self) -> int:
        settled = self.recorded + self.refused.total() + self.dropped.total()
        return self.captured - settled - len(self.pending)

    def camera_ended(self, state: CameraState, recording: str) -> None:
        """The camera is at its end: frames before the first and after the last that was seen are accounted for."""
        if state.boot != self._boot and self._boot:
            return
        if state.played_for == recording and (self._first_of_pass is not None or not self._boot):
            first = self._first_of_pass if self._first_of_pass is not None else state.captured + 1
            before = max(first - state.play_first, 0)
            self.captured += before
            self._drop("detect", before)
        if self._boot:
            after = max(state.captured - self._last, 0)
            self.captured += after
            self._drop("detect", after)
            self._last = state.captured

    def close(self) -> None:
        """No further frame comes: what a restart of label left open, and no frame has settled since, was lost then."""
        if self._resumed:
            self._resumed = False
            self._drop("label_restart", self._unaccounted())

    def reached(self, state: CameraState) -> bool:
        """Whether the camera's last frame has been accounted for."""
        return self._boot == state.boot and self._last >= state.captured

    @property
    def started(self) -> bool:
        """Whether a frame has been accounted for."""
        return bool(self._boot)

    def looked_at(self, source: str, *, counted: bool) -> None:
        """A frame was labelled. One that isn't ``counted`` (a preview, or one from the past) counts by this."""
        if not counted:
            self.captured += 1
        self.labelled += 1
        self.detected[source] += 1

    def refuse(self, reason: str) -> None:
        """A frame was looked at and not recorded."""
        self.refused[reason] += 1

    def drop(self, place: Place) -> None:
        """A frame was lost here."""
        self._drop(place, 1)

    def ordered(self, sample: str) -> None:
        """A frame is on its way to the disk."""
        self.pending.add(sample)

    def stored(self, sample: str) -> None:
        """It is durable."""
        if sample in self.pending:
            self.pending.remove(sample)
            self.recorded += 1

    def failed(self, sample: str, reason: str) -> None:
        """It was refused on its way."""
        if sample in self.pending:
            self.pending.remove(sample)
            self.refused[reason] += 1

    def _drop(self, place: str, frames: int) -> None:
        if frames > 0:
            self.dropped[place] += frames

    def ledger(self) -> CameraLedger:
        """As it goes to the store and to the bus."""
        return CameraLedger(
            captured=self.captured,
            detected=dict(self.detected),
            labelled=self.labelled,
            recorded=self.recorded,
            refused=dict(self.refused),
            dropped=dict(self.dropped),
            pending=len(self.pending),
            last_count=self._last,
            boot=self._boot,
            gaps=self.gaps.listed,
            gaps_unlisted=self.gaps.unlisted,
        )
