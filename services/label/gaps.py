"""When a camera gave no pictures during a recording: from its frames' times and what it says of itself. Pure."""

from __future__ import annotations

from common import clock
from common.ledgers import CameraLedger, Gap
from common.messages import CameraState, FrameRef

LEAST_NS = 1_000_000_000
LEAST_PERIODS = 5
"""Frames further apart than both have a gap between them; one that its camera tells of may be shorter."""
LISTED = 100
"""Further gaps are counted only: a cable that is loose for a day must not fill the ledger."""
_AWAY = ("lost", "stalled")
_SAID_NOTHING = "no picture came; the camera didn't say why"
_RESTARTED = "its capture process was started again"


class Gaps:
    """One camera's in one recording; goes on from those ``known`` before a restart of the label process."""

    def __init__(self, known: CameraLedger) -> None:
        self._open = known.gaps[-1] if known.gaps and known.gaps[-1].to is None else None
        self._listed = list(known.gaps[:-1] if self._open else known.gaps)
        self._unlisted = known.gaps_unlisted
        self._newest: FrameRef | None = None
        self._away: tuple[int, str] | None = None
        self._period_ns: int | None = None
        self._heard_ns = 0

    def hear(self, state: CameraState, mono_ns: int, wall_ns: int) -> None:
        """What the camera says of itself; the present time on both clocks."""
        live = not state.paced and state.played_for is None and state.phase in ("streaming", *_AWAY)
        self._period_ns = int(1e9 / state.fps) if live else None
        self._heard_ns = self._heard_ns or mono_ns
        if state.phase not in _AWAY:
            return
        last = self._newest
        if last is not None and last.boot == state.boot and last.captured_mono_ns > state.newest_mono_ns:
            return  # said before that frame: it is over
        newest_ns = state.newest_mono_ns or (last.captured_mono_ns if last else 0)
        newest_ns = newest_ns if last else max(newest_ns, self._heard_ns)
        self._away = (newest_ns, state.last_error or f"the camera is {state.phase}")
        if self._open is None:
            since = wall_ns - (mono_ns - newest_ns)
            self._open = Gap(since=clock.iso_utc(since), since_wall_ns=since, reason=self._away[1])

    def frame(self, ref: FrameRef, missed: int) -> None:
        """A frame; ``missed`` is how many came between the one before and this, and were lost on the way here."""
        if self._away is not None and ref.captured_mono_ns <= self._away[0]:
            return  # taken before the camera was lost
        before, self._newest, self._away = self._newest, ref, None
        if self._open is None and before is not None and self._period_ns is not None:
            silent_ns = ref.captured_mono_ns - before.captured_mono_ns - missed * self._period_ns
            if silent_ns > max(LEAST_NS, LEAST_PERIODS * self._period_ns):
                why = _SAID_NOTHING if before.boot == ref.boot else _RESTARTED
                since = before.captured_wall_ns
                self._open = Gap(since=clock.iso_utc(since), since_wall_ns=since, reason=why)
        self._close(ref.captured_wall_ns)

    def finish(self, mono_ns: int, wall_ns: int) -> None:
        """The recording ends now; a camera that is away was so until its end."""
        if self._open is None and self._newest is not None and self._period_ns is not None:
            silent_ns = mono_ns - self._newest.captured_mono_ns
            if silent_ns > max(LEAST_NS, LEAST_PERIODS * self._period_ns):
                since = self._newest.captured_wall_ns
                self._open = Gap(since=clock.iso_utc(since), since_wall_ns=since, reason=_SAID_NOTHING)
        self._close(wall_ns)

    def _close(self, wall_ns: int) -> None:
        gap, self._open = self._open, None
        if gap is None:
            return
        if len(self._listed) >= LISTED:
            self._unlisted += 1
            return
        seconds = round(max(wall_ns - gap.since_wall_ns, 0) / 1e9, 3)
        self._listed.append(gap.model_copy(update={"to": clock.iso_utc(wall_ns), "seconds": seconds}))

    @property
    def listed(self) -> tuple[Gap, ...]:
        """The gaps in their order; the last may still be open."""
        return (*self._listed, *((self._open,) if self._open else ()))

    @property
    def unlisted(self) -> int:
        """How many there were beyond those listed."""
        return self._unlisted
