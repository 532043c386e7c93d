"""The record state: what label and store report, never what was clicked. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from common.ids import sample_camera, sample_captured_at
from common.messages import Labels, RecordingState, SamplesChanged
from common.service.meters import Rate
from common.words import words_for
from services.console.line import Plain

if TYPE_CHECKING:
    from services.console.state import State

FRESH_NS = 3_000_000_000
STALE_LABEL_NS = 1_000_000_000
REFUSED_FOR_NS = 60_000_000_000
_SAMPLE_BYTES = 2_300_000
"""Until samples were seen: a 720p colour picture with depth."""


@dataclass(slots=True)
class _Heard:
    state: RecordingState
    at_ns: int


class RecordView:
    """Recordings, requests under way, the last sample; ``data`` makes the topic ``record`` of it."""

    def __init__(self) -> None:
        self._heard: dict[tuple[str, str], _Heard] = {}
        self._ended: set[tuple[str, str]] = set()
        self._asked: dict[int, Plain] = {}
        self._next = 0
        self._refused: list[tuple[int, str]] = []
        self._refused_before: dict[tuple[str, str], dict[str, int]] = {}
        self._last: dict[str, str] | None = None
        self._stored = 0
        self._saved = Rate(30.0)
        self._sample_bytes = float(_SAMPLE_BYTES)

    # --- news ---------------------------------------------------------------------------------------------

    def hear(self, state: RecordingState, now_ns: int) -> list[str]:
        """A recording's account; returns sentences about recordings that have just ended."""
        key = (state.ledger.spec.recording, state.camera)
        self._heard[key] = _Heard(state, now_ns)
        account = state.ledger.cameras.get(state.camera)
        if account is not None:
            self._note_refusals(key, account.refused, now_ns)
        if state.ledger.phase not in {"ended", "interrupted"} or key in self._ended:
            return []
        self._ended.add(key)
        if account is None:
            return []
        lost = sum(account.dropped.values())
        return [f"{state.camera}: {account.recorded} saved, {sum(account.refused.values())} refused, {lost} lost."]

    def _note_refusals(self, key: tuple[str, str], refused: dict[str, int], now_ns: int) -> None:
        before = self._refused_before.get(key, {})
        for code, count in refused.items():
            if code not in {"not_due", "not_asked", "not_new"} and count > before.get(code, 0):
                self._refused += [(now_ns, code)] * min(count - before.get(code, 0), 1000)
        self._refused_before[key] = dict(refused)

    def samples(self, changed: SamplesChanged) -> None:
        """Samples changed, durably."""
        self._stored = changed.stored
        if changed.what == "stored" and changed.samples:
            self._saved.mark(len(changed.samples))
            self._saw(changed.samples[-1])
        elif changed.what == "deleted" and self._last is not None and self._last["sample"] in changed.samples:
            self._last = None

    @staticmethod
    def camera_of(sample: str) -> str:
        """The camera in a sample's name."""
        return sample_camera(sample)

    def asked(self, fields: Plain) -> int:
        """A ``record`` command is under way."""
        self._next += 1
        self._asked[self._next] = fields
        return self._next

    def answered(self, number: int, answer: Plain, now_ns: int) -> None:
        """It was answered."""
        self._asked.pop(number, None)
        code = (answer.get("error") or {}).get("code")
        if code is not None:
            self._refused.append((now_ns, str(code)))

    def live(self, now_ns: int) -> list[RecordingState]:
        """The recordings that label speaks of at present and that have not ended."""
        fresh = [item.state for item in self._heard.values() if now_ns - item.at_ns < FRESH_NS]
        return [state for state in fresh if state.ledger.phase in {"running", "finishing"}]

    def seed(self, stored: Mapping[str, Any], mean_bytes: float | None) -> None:
        """What was there before the console: how many samples, the newest one, how large they are."""
        self._stored = len(stored)
        if self._last is None and stored:
            self._saw(max(stored))
        if mean_bytes is not None:
            self._sample_bytes = mean_bytes

    def _saw(self, name: str) -> None:
        self._last = {"sample": name, "time": sample_captured_at(name), "camera": sample_camera(name)}

    # --- the topic ----------------------------------------------------------------------------------------

    def data(self, state: State, now_ns: int) -> dict[str, Any]:
        """See the contract of the WebSocket (docs/reference/console.md)."""
        self._refused = [item for item in self._refused if now_ns - item[0] < REFUSED_FOR_NS]
        live = self.live(now_ns)
        running = [item for item in live if item.ledger.phase == "running"]
        finishing = [item for item in live if item.ledger.phase == "finishing"]
        can = {camera: self._can(state, camera, now_ns) for camera in state.cameras}
        blocked = self._blocked(state)
        shown: dict[str, Any] = {
            "phase": "ready",
            "can": can,
            "mode": None,
            "recording": None,
            "since": None,
            "count": self._stored,
            "refused": self._refusals(),
            "last": self._last,
            "disk": self.disk(state.status),
            "session": state.status.get("session"),
        }
        if running:
            shown |= _described(running) | {"phase": "recording"}
        elif finishing:
            pending = sum(_account(item, "pending") for item in finishing)
            shown |= _described(finishing) | {"phase": "finishing", "finishing": pending}
        elif blocked is not None:
            shown |= {"phase": "cannot", "why": _why(blocked)}
        elif self._asked:
            shown["phase"] = "asked"
        return shown

    def _blocked(self, state: State) -> str | None:
        status = state.status
        if not status.get("ok"):
            return "no_answer"
        if not state.alive("store"):
            return "store_down"
        if not any(name.startswith("label.") and state.alive(name) for name in status.get("services", {})):
            return "label_down"
        disk = self.disk(status)
        if disk["samples_left"] == 0:
            return "disk_full"
        if not status.get("session"):
            return "no_session"
        if not any(camera.get("present") for camera in status.get("cameras", {}).values()):
            return "no_frame"
        return None

    def _can(self, state: State, camera: str, now_ns: int) -> dict[str, Any]:
        seen, _ = state.cameras[camera]
        if seen.newest_mono_ns and now_ns - seen.newest_mono_ns > FRESH_NS and seen.phase not in {"waiting", "ended"}:
            return {"ok": False, "code": "no_frame", "title": words_for("no_frame").title}
        found = state.labels.get(camera)
        if found is None or now_ns - found[1] > STALE_LABEL_NS:
            code = state.why_no_label(camera)
            return {"ok": False, "code": code, "title": words_for(code).title}
        return can_record(found[0], state.keeps)

    def _refusals(self) -> list[dict[str, Any]]:
        counts = Counter(code for _, code in self._refused)
        return [
            {"code": code, "title": words_for(code).title, "what_to_do": words_for(code).what_to_do, "times": times}
            for code, times in counts.most_common(5)
        ]

    def disk(self, status: Plain) -> dict[str, Any]:
        """Samples and hours that still fit."""
        free = (status.get("disk") or {}).get("free_bytes")
        if free is None:
            return {"free_bytes": None, "samples_left": None, "hours_left": None}
        left = int(free / self._sample_bytes)
        rate = self._saved.per_second()
        return {
            "free_bytes": free,
            "samples_left": left,
            "hours_left": round(left / (rate or 1.0) / 3600, 1),  # as of late, else at one a second
        }


def can_record(labels: Labels, keeps: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Whether a frame with this label would be taken, in words; ``keeps``: codes that the rig does not refuse."""
    if labels.missing and not ("incomplete" in keeps and labels.objects):
        return {"ok": False, "code": "incomplete", "title": words_for("incomplete").title}
    if not labels.objects:
        return {"ok": False, "code": "no_object", "title": words_for("no_object").title}
    if "ambiguous_pose" not in keeps and any(item.quality.ambiguous for item in labels.objects):
        return {"ok": False, "code": "ambiguous_pose", "title": words_for("ambiguous_pose").title}
    names = ", ".join(item.name for item in labels.objects)
    return {"ok": True, "title": f"{names} in view"}


def _why(code: str) -> dict[str, str]:
    words = words_for(code)
    return {"code": code, "title": words.title, "what_to_do": words.what_to_do}


def _described(states: list[RecordingState]) -> dict[str, Any]:
    spec = states[0].ledger.spec
    return {
        "mode": spec.mode,
        "every_s": spec.every_s,
        "recording": spec.recording,
        "since": spec.started_at,
        "count": sum(_account(item, "recorded") for item in states if item.ledger.spec.recording == spec.recording),
        "until": spec.until_count,
        "cameras": sorted({item.camera for item in states}),
        "waiting_for": {item.camera: item.waiting_for for item in states if item.waiting_for},
    }


def _account(state: RecordingState, name: str) -> int:
    account = state.ledger.cameras.get(state.camera)
    return 0 if account is None else int(getattr(account, name))
