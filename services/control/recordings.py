"""The recordings that label processes report, and their ledgers joined over cameras. Pure.

Control keeps nothing of its own: it learns the recordings from the bus, so it may be restarted at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass

from common.ledgers import CameraLedger, Ledger, RecordingPhase
from common.messages import RecordingState

REMEMBER_ENDED_NS = 60_000_000_000
GONE_AFTER_BEATS = 5
"""A label process that is well and has not spoken of a recording for so many heartbeats has none."""
_OPEN: tuple[RecordingPhase, ...] = ("running", "finishing")
_ORDER: tuple[RecordingPhase, ...] = ("running", "finishing", "interrupted", "ended")


@dataclass(frozen=True, slots=True)
class Seen:
    """One camera's part of a recording: as last reported, by whom, and when."""

    state: RecordingState
    source: str
    seen_ns: int
    beats: int

    @property
    def open(self) -> bool:
        """Whether it still takes frames or saves them."""
        return self.state.ledger.phase in _OPEN


class Recordings:
    """Recordings by id, each by camera."""

    def __init__(self) -> None:
        self._seen: dict[str, dict[str, Seen]] = {}

    def hear(self, state: RecordingState, source: str, now_ns: int, beats: int) -> None:
        """A label process reports; ``beats`` is how many heartbeats of it have been heard.

        What has ended stays so: a state that was published before the answer to `stop` may come after it.
        """
        own = self._seen.setdefault(state.ledger.spec.recording, {})
        reported, before = Seen(state, source, now_ns, beats), own.get(state.camera)
        if before is None or before.open or not reported.open or before.source != source:
            own[state.camera] = reported

    def tidy(self, now_ns: int, beats: Callable[[str], int]) -> None:
        """Forget what ended a minute ago, and what its label process no longer knows (``beats`` of a service)."""
        for recording, parts in list(self._seen.items()):
            for camera, seen in list(parts.items()):
                ended = not seen.open and now_ns - seen.seen_ns > REMEMBER_ENDED_NS
                lost = seen.open and beats(seen.source) - seen.beats >= GONE_AFTER_BEATS
                if ended or lost:
                    del parts[camera]
            if not parts:
                del self._seen[recording]

    @property
    def known(self) -> dict[str, dict[str, Seen]]:
        """All of them, the oldest first."""
        return dict(sorted(self._seen.items()))

    def open_ids(self) -> tuple[str, ...]:
        """Recordings that run or finish; requests of `record` are none."""
        return tuple(
            recording
            for recording, parts in self.known.items()
            if any(seen.open and seen.state.ledger.spec.mode != "record" for seen in parts.values())
        )

    def open_cameras(self, recording: str) -> dict[str, str]:
        """Camera to the label process that reported it, for the cameras on which the recording runs or finishes."""
        return {camera: seen.source for camera, seen in self._seen.get(recording, {}).items() if seen.open}

    def parts(self, recording: str, *, but: Container[str], ended: bool) -> tuple[Ledger, ...]:
        """The ledgers of its cameras except ``but``; with ``ended`` only of those where it is over."""
        seen = self._seen.get(recording, {})
        return tuple(
            part.state.ledger for camera, part in seen.items() if camera not in but and not (ended and part.open)
        )

    def ledger(self, recording: str) -> Ledger | None:
        """As last reported; None for an unknown recording."""
        return join(seen.state.ledger for seen in self._seen.get(recording, {}).values())


def join(parts: Iterable[Ledger]) -> Ledger | None:
    """One ledger from the parts of several cameras; a later part wins over an earlier one. None for no parts.

    The recording is ended when all parts are, and as long as one runs it runs.
    """
    cameras: dict[str, CameraLedger] = {}
    found: list[Ledger] = []
    for part in parts:
        cameras.update(part.cameras)
        found.append(part)
    if not found:
        return None
    phase = min((part.phase for part in found), key=_ORDER.index)
    ends = [part.ended_at for part in found if part.ended_at is not None]
    return found[-1].model_copy(
        update={
            "cameras": cameras,
            "phase": phase,
            "ended_at": max(ends) if ends and phase not in _OPEN else None,
            "why": next((part.why for part in reversed(found) if part.why is not None), None),
        }
    )
