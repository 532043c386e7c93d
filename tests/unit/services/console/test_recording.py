"""The record state: from what label and store report to what the page shows."""

from __future__ import annotations

from typing import Any

import pytest

from common import clock
from common.labels import Missing
from common.ledgers import CameraLedger, Ledger, RecordingSpec
from common.messages import CameraState, FrameRef, Labels, RecordingState, SamplesChanged, ServiceState
from services.console.hub import StateHub
from services.console.recording import FRESH_NS, REFUSED_FOR_NS, can_record
from services.console.state import State
from tests.support.samples import camera_label, object_label

SAMPLE = "20260830T120431.120Z-cam0-48211"
STATUS = {
    "ok": True, "session": "s", "dataset": "/d", "disk": {"free_bytes": 30_000_000},
    "services": {"store": {}, "label.0": {}}, "cameras": {"cam0": {"present": True}},
}  # fmt: skip


def labels(*objects: Any, missing: tuple[Missing, ...] = ()) -> Labels:
    ref = FrameRef(camera="cam0", boot="a", ring="r", frame=1, count=1, captured_mono_ns=1, captured_wall_ns=0)
    return Labels(ref=ref, objects=objects, missing=missing)


def beat(service: str, **more: Any) -> ServiceState:
    return ServiceState(service=service, boot="b", pid=1, phase="running", **more)


@pytest.fixture
def state() -> State:
    """A stack that is well, seen a moment ago."""
    made = State(StateHub())
    made.status = dict(STATUS)
    for service in ("store", "label.0", "detect.0", "control"):
        made.hear_service(beat(service))
    made.hear_camera(CameraState.model_construct(camera=camera_label(), newest_mono_ns=0, phase="streaming"))
    made.hear_labels(labels(object_label()))
    return made


def told(state: State, later_ns: int = 0) -> dict[str, Any]:
    return state.record.data(state, clock.monotonic_ns() + later_ns)


def recording(phase: str = "running", camera: str = "cam0", **account: Any) -> RecordingState:
    spec = RecordingSpec(
        recording="rec-1", mode="all", cameras=("cam0", "cam1"), every_s=1.0, started_at="2026-08-30T12:04:31.120Z"
    )
    ledger = Ledger(spec=spec, phase=phase, cameras={camera: CameraLedger(**account)})  # type: ignore[arg-type]
    return RecordingState(camera=camera, ledger=ledger, waiting_for="no_object")


def test_ready_says_whether_the_present_frame_would_be_taken(state: State) -> None:
    found = told(state)
    assert (found["phase"], found["session"]) == ("ready", "s")
    assert found["can"] == {"cam0": {"ok": True, "title": "box-0 in view"}}
    assert (found["disk"]["samples_left"], found["disk"]["free_bytes"]) == (13, 30_000_000)
    state.hear_labels(labels())
    assert told(state)["can"]["cam0"]["code"] == "no_object"
    assert told(state, 2 * FRESH_NS)["can"]["cam0"]["ok"] is False, "an old label says nothing of now"


def test_can_heeds_what_the_rig_keeps() -> None:
    missing = (Missing(object="box-2", reason="not_detected"),)
    doubtful = object_label()
    doubtful = doubtful.model_copy(update={"quality": doubtful.quality.model_copy(update={"ambiguous": True})})
    assert can_record(labels(doubtful))["code"] == "ambiguous_pose"
    assert can_record(labels(doubtful), frozenset({"ambiguous_pose"}))["ok"]
    assert can_record(labels(object_label(), missing=missing))["code"] == "incomplete"
    assert can_record(labels(object_label(), missing=missing), frozenset({"incomplete"}))["ok"]
    assert can_record(labels(missing=missing), frozenset({"incomplete"}))["code"] == "incomplete"


def test_a_recording_is_what_label_reports_over_all_its_cameras(state: State) -> None:
    now = clock.monotonic_ns()
    assert state.record.hear(recording(recorded=3), now) == []
    state.record.hear(recording(camera="cam1", recorded=4), now)
    found = told(state)
    assert (found["phase"], found["count"], found["recording"]) == ("recording", 7, "rec-1")
    assert (found["cameras"], found["waiting_for"]) == (["cam0", "cam1"], {"cam0": "no_object", "cam1": "no_object"})
    assert told(state, 2 * FRESH_NS)["phase"] == "ready", "nobody speaks of it any more"
    state.record.hear(recording("finishing", pending=2, recorded=3), now)
    state.record.hear(recording("ended", camera="cam1", recorded=4), now)
    found = told(state)
    assert (found["phase"], found["finishing"]) == ("finishing", 2)
    ended = recording("ended", recorded=5, refused={"no_object": 2}, dropped={"label": 1})
    assert state.record.hear(ended, now) == ["cam0: 5 saved, 2 refused, 1 lost."]
    assert state.record.hear(ended, now) == [], "told once"
    assert told(state)["phase"] == "ready"


def test_refusals_are_counted_for_a_minute_and_what_is_no_refusal_is_left_out(state: State) -> None:
    now = clock.monotonic_ns()
    state.record.hear(recording(refused={"no_object": 2, "not_due": 90, "not_new": 5}), now)
    state.record.hear(recording(refused={"no_object": 3, "not_due": 95}), now)
    number = state.record.asked({"camera": "cam0"})
    state.record.answered(number, {"ok": False, "error": {"code": "ambiguous_pose"}}, now)
    found = {one["code"]: one["times"] for one in told(state)["refused"]}
    assert found == {"no_object": 3, "ambiguous_pose": 1}
    assert told(state, 2 * REFUSED_FOR_NS)["refused"] == []


def test_a_request_under_way_is_asked_until_it_is_answered(state: State) -> None:
    number = state.record.asked({"camera": "cam0"})
    assert told(state)["phase"] == "asked"
    state.record.answered(number, {"ok": True}, 0)
    assert told(state)["phase"] == "ready"


def test_what_stops_any_recording_is_said_first(state: State) -> None:
    for change, code in (
        ({"cameras": {"cam0": {"present": False}}}, "no_frame"),
        ({"session": None}, "no_session"),
        ({"disk": {"free_bytes": 1000}}, "disk_full"),
        ({"services": {"store": {}}}, "label_down"),
        ({"ok": False}, "no_answer"),
    ):
        state.status = STATUS | change
        found = told(state)
        assert (found["phase"], found["why"]["code"]) == ("cannot", code)
        assert found["why"]["title"]


def test_the_last_sample_goes_when_it_is_taken_back(state: State) -> None:
    def changed(what: str) -> SamplesChanged:
        return SamplesChanged(session="s", what=what, samples=(SAMPLE,), stored=1, in_bin=0)  # type: ignore[arg-type]

    state.record.samples(changed("stored"))
    assert told(state)["last"] == {"sample": SAMPLE, "time": "2026-08-30T12:04:31.120Z", "camera": "cam0"}
    state.record.samples(changed("deleted"))
    assert told(state)["last"] is None
    state.record.seed({SAMPLE: {}}, 3_000_000.0)
    assert told(state)["last"]["sample"] == SAMPLE
    assert told(state)["disk"]["samples_left"] == 10, "as large as those that there are"
