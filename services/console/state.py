"""From the bus to what the pages are told: status, labels in short, disk, session, record state, and events."""

from __future__ import annotations

from typing import Any

from common import clock
from common.config import Rig
from common.frames import shm_room
from common.messages import CameraState, Labels, RecordingState, SamplesChanged, ServiceState
from common.service import Liveness
from common.service.liveness import GONE
from common.words import words_for
from services.console.events import ServiceWatch
from services.console.hub import StateHub
from services.console.line import Plain
from services.console.recording import STALE_LABEL_NS, RecordView

LABELS_LATE = "labels_late"
QUIET_NS = 10_000_000_000
"""In the first seconds after a start nothing is a fault yet."""


class State:
    """Everything that was heard, and the topics made of it. Its caller ticks it five times a second."""

    def __init__(self, hub: StateHub) -> None:
        self.hub = hub
        self.status: Plain = {}
        self.cameras: dict[str, tuple[CameraState, int]] = {}
        self.labels: dict[str, tuple[Labels, int]] = {}
        self.marker_seen: dict[int, str] = {}
        self.liveness = Liveness()
        self.record = RecordView()
        self.keeps: frozenset[str] = frozenset()
        self._watch = ServiceWatch(hub, clock.monotonic_ns() + QUIET_NS)
        self._warned: set[tuple[str, int, str]] = set()

    def follow(self, rig: Rig) -> None:
        """Heed what this rig lets be recorded that others refuse."""
        config = rig.config
        keeping = {"incomplete": config.record.incomplete, "ambiguous_pose": config.pose.ambiguous}
        self.keeps = frozenset(code for code, what in keeping.items() if what == "keep")

    # --- news ---------------------------------------------------------------------------------------------

    def hear_camera(self, state: CameraState) -> None:
        """A camera says what it is."""
        self.cameras[state.camera.name] = (state, clock.monotonic_ns())

    def hear_labels(self, labels: Labels) -> None:
        """A frame's label."""
        self.labels[labels.ref.camera] = (labels, clock.monotonic_ns())
        seen = clock.iso_utc(clock.wall_ns())
        for item in labels.objects:
            for side in item.sides:
                self.marker_seen[side.marker] = seen
        for left in labels.left_out:
            if left.reason != "not_detected":
                self.marker_seen[left.marker] = seen

    def hear_service(self, state: ServiceState) -> None:
        """A heartbeat; its warnings are told once."""
        now = clock.monotonic_ns()
        self.liveness.feed(state, now)
        self._watch.hear(state, now)
        for warning in state.warnings:
            key = (state.service, warning.wall_ns, warning.code)
            if key not in self._warned:
                self._warned.add(key)
                words = words_for(warning.code)
                self.hub.happened("warning", warning.message, code=warning.code, what_to_do=words.what_to_do or None)

    def hear_recording(self, state: RecordingState) -> None:
        """A recording's account."""
        for ended in self.record.hear(state, clock.monotonic_ns()):
            self.hub.happened("ended", ended)

    def hear_samples(self, changed: SamplesChanged) -> None:
        """Samples are durable, in the bin, or back."""
        self.record.samples(changed)
        kind = {"stored": "saved", "deleted": "deleted", "restored": "restored"}[changed.what]
        for sample in changed.samples[-20:]:
            camera = self.record.camera_of(sample)
            self.hub.happened(kind, f"{camera}: {sample}", sample=sample, camera=camera)

    def tick(self) -> None:
        """Make the topics anew; what didn't change is not told."""
        now = clock.monotonic_ns()
        self._watch.tick(now)
        self.hub.tell("labels", {name: self._in_short(*seen, now) for name, seen in self.labels.items()})
        self.hub.tell("record", self.record.data(self, now))
        self.hub.tell("auto", {state.camera: _auto(state) for state in self.record.live(now) if state.auto is not None})

    def heard_status(self, answer: Plain) -> None:
        """What ``status`` answered, or why it didn't."""
        self.status = answer
        seen = {str(name): at for name, at in self.marker_seen.items()}
        self.hub.tell("status", answer | {"markers_seen": seen, "shm": _shm()})
        if answer.get("ok"):
            self.hub.tell("session", {"session": answer.get("session"), "dataset": answer.get("dataset")})
            self.hub.tell("disk", self.record.disk(answer))

    def newest_labels(self) -> list[Labels]:
        """The newest label of each camera that gives labels at present."""
        now = clock.monotonic_ns()
        return [labels for labels, heard_ns in self.labels.values() if now - heard_ns < STALE_LABEL_NS]

    # --- questions ----------------------------------------------------------------------------------------

    def why_no_label(self, camera: str) -> str:
        """The code that says why a frame of ``camera`` has no label."""
        now = clock.monotonic_ns()
        for service, code in (("detect", "detect_down"), ("label", "label_down")):
            known = [seen for name, seen in self.liveness.seen().items() if name.startswith(f"{service}.")]
            dead = [s for s in known if s.state.phase == GONE or not self.liveness.is_alive(s.state.service, now)]
            if not known or len(dead) == len(known) or any(camera in seen.state.cameras for seen in dead):
                return code
        return LABELS_LATE

    def alive(self, service: str) -> bool:
        """Whether a service is heard."""
        return self.liveness.is_alive(service, clock.monotonic_ns())

    @staticmethod
    def _in_short(labels: Labels, heard_ns: int, now_ns: int) -> dict[str, Any]:
        return {
            "frame": labels.ref.frame,
            "age_ms": round((now_ns - labels.ref.captured_mono_ns) / 1e6),
            "late": now_ns - heard_ns > 1_000_000_000,
            "objects": [
                {
                    "name": item.name,
                    "type": item.type,
                    "distance_mm": round(item.distance_mm, 1),
                    "uncertainty_mm": round(error.distance_mm, 1) if (error := item.quality.uncertainty) else None,
                    "ambiguous": item.quality.ambiguous,
                    "pose_source": item.pose_source,
                    "sides": [side.class_name for side in item.sides],
                }
                for item in labels.objects
            ],
            "left_out": [{"marker": left.marker, "reason": left.reason} for left in labels.left_out],
            "missing": [{"object": item.object, "reason": item.reason} for item in labels.missing],
        }


def _shm() -> Plain | None:
    """How full shared memory is; None where it can't be told."""
    try:
        free, total = shm_room()
    except OSError:
        return None
    return {"total_bytes": total, "used_bytes": total - free}


def _auto(state: RecordingState) -> Plain:
    """What `mode: auto` thinks of the newest frame, with the limits it goes by."""
    assert state.auto is not None
    spec, reason = state.ledger.spec, state.auto.reason
    return {
        "recording": spec.recording,
        "limits": None if spec.auto is None else spec.auto.model_dump(mode="json"),
        "frame": state.auto.frame,
        "reason": reason,
        "title": "This view is worth a sample." if reason is None else words_for(reason).title,
        "objects": [item.model_dump(mode="json") for item in state.auto.objects],
    }
