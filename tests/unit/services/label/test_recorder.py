"""Which frames become samples, and what whoever asked is told."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from common import clock
from common.errors import FrameLostError, RefusedError
from common.geometry import Pose
from common.ledgers import RecordingSpec
from common.messages import Answer, Detections, ErrorInfo, FrameRef, RecordOrder, StartOrder
from services.label.recorder import Recorder
from services.label.samples import Outcome, Taker


def detections(count: int, mono_ns: int | None = None) -> Detections:
    stamp = clock.monotonic_ns() if mono_ns is None else mono_ns
    return Detections(
        ref=FrameRef(
            camera="cam0",
            boot="b",
            ring="r",
            frame=count,
            count=count,
            captured_mono_ns=stamp,
            captured_wall_ns=stamp,
        )
    )


def seen(*, objects: int) -> Any:
    return SimpleNamespace(objects=("box",) * objects, left_out=(), missing=())


class Bench:
    """A recorder whose samples begin, end and fail as told."""

    def __init__(self) -> None:
        self.answers: list[Answer] = []
        self.recorder = Recorder(self.answers.append)
        self.begun: dict[str, list[Taker]] = {}
        self.refuse_with: Exception | None = None

    def begin(self, item: Detections, takers: list[Taker]) -> str:
        if self.refuse_with is not None:
            raise self.refuse_with
        name = f"s{item.ref.frame}"
        self.begun[name] = takers
        return name

    def frame(self, count: int, *, objects: int = 1, mono_ns: int | None = None) -> None:
        self.recorder.frame(detections(count, mono_ns), seen(objects=objects), self.begin)

    def end(self, name: str, reason: str | None = None) -> None:
        sample = SimpleNamespace(name=name, takers=self.begun.pop(name), objects=())
        self.recorder.outcome(Outcome(sample, reason))  # type: ignore[arg-type]

    def tick(self) -> None:
        self.recorder.tick({})


@pytest.fixture
def bench() -> Bench:
    return Bench()


def order(**more: Any) -> RecordOrder:
    return RecordOrder(key="k", recording="rec-1", camera="cam0", **more)


def start(**more: Any) -> StartOrder:
    spec = RecordingSpec(recording="rec-2", mode="all", cameras=("cam0",), started_at="now", **more)
    return StartOrder(key="start", spec=spec, camera="cam0")


def test_a_request_takes_the_first_fitting_frame_and_answers_when_it_is_durable(bench: Bench) -> None:
    bench.recorder.record(order())
    bench.frame(1, objects=0)
    bench.frame(2)
    bench.frame(3)
    assert list(bench.begun) == ["s2"], "one candidate at a time"
    bench.tick()
    assert bench.answers == []
    bench.end("s2")
    bench.tick()
    assert bench.answers == [Answer(key="k", samples=("s2",))]


def test_frames_from_before_the_order_do_not_fit(bench: Bench) -> None:
    now = clock.monotonic_ns()
    bench.recorder.record(order(since_mono_ns=now))
    bench.frame(1, mono_ns=now - 1)
    assert not bench.begun
    bench.frame(2, mono_ns=now + 1)
    assert list(bench.begun) == ["s2"]


def test_at_the_deadline_the_last_reason_is_told(bench: Bench) -> None:
    bench.recorder.record(order(timeout_s=0.0))
    bench.frame(1, objects=0)
    bench.tick()
    (answer,) = bench.answers
    assert answer.error is not None
    assert answer.error.code == "no_object"
    assert "turn a side" in answer.error.message


def test_a_request_without_any_frame_says_that_no_picture_came(bench: Bench) -> None:
    bench.recorder.record(order(timeout_s=0.0))
    bench.tick()
    assert bench.answers[0].error is not None
    assert bench.answers[0].error.code == "no_frame"


def test_a_late_sample_is_pending_in_the_answer_and_settled_by_the_ledger(bench: Bench) -> None:
    bench.recorder.record(order(timeout_s=0.0))
    bench.frame(1)
    bench.tick()
    assert bench.answers[0].pending == ("s1",)
    assert bench.answers[0].error is not None
    assert bench.answers[0].error.code == "timeout"
    assert list(bench.recorder.ledger_orders()) == []
    bench.end("s1")
    (ledger,) = bench.recorder.ledger_orders()
    assert ledger.ended
    assert ledger.account.recorded == 1
    assert ledger.account.settled


def test_a_late_sample_does_not_hide_what_the_ones_before_were_refused_for(bench: Bench) -> None:
    bench.recorder.record(order(count=2, timeout_s=0.0))
    bench.frame(1)
    bench.end("s1", "disk_full")
    bench.frame(2)
    bench.tick()
    (answer,) = bench.answers
    assert answer.pending == ("s2",)
    assert answer.error is not None
    assert answer.error.code == "disk_full"
    assert "1 more under way" in answer.error.message


def test_a_sample_that_was_stored_clears_what_was_wrong_before(bench: Bench) -> None:
    bench.recorder.record(order(count=2, timeout_s=0.0))
    bench.frame(1)
    bench.end("s1", "disk_full")
    bench.frame(2)
    bench.end("s2")
    bench.frame(3)
    bench.tick()
    assert bench.answers[0].error is not None
    assert bench.answers[0].error.code == "timeout"


def test_a_repeated_order_is_the_same_order(bench: Bench) -> None:
    assert bench.recorder.record(order(frame=4)) is not None
    assert bench.recorder.record(order(frame=4)) is None, "whoever looks for its frame again finds it gone"
    assert len(bench.recorder.requests) == 1


def test_a_wanted_frame_that_is_refused_ends_a_request_for_just_that_frame(bench: Bench) -> None:
    bench.recorder.record(order(frame=2))
    bench.frame(1)
    bench.frame(2, objects=0)
    bench.tick()
    assert bench.answers[0].error is not None
    assert bench.answers[0].error.code == "no_object"


def test_background_refuses_an_object_in_view(bench: Bench) -> None:
    bench.recorder.record(order(background=True, timeout_s=0.0))
    bench.frame(1, objects=1)
    assert not bench.begun
    bench.frame(2, objects=0)
    assert list(bench.begun) == ["s2"]


def test_one_sample_serves_a_request_and_a_recording(bench: Bench) -> None:
    bench.recorder.record(order())
    bench.recorder.start(start())
    bench.frame(1)
    assert len(bench.begun["s1"]) == 2
    bench.end("s1")
    bench.tick()
    assert bench.answers[0].samples == ("s1",)
    (state,) = bench.recorder.states()
    assert state.ledger.cameras["cam0"].recorded == 1


def test_a_recording_counts_refusals_and_drops_by_reason(bench: Bench) -> None:
    bench.recorder.start(start())
    bench.frame(1, objects=0)
    bench.refuse_with = RefusedError("full", code="backlog_full")
    bench.frame(2)
    bench.refuse_with = FrameLostError("gone")
    bench.frame(3)
    bench.refuse_with = None
    bench.recorder.dropped(detections(4))
    bench.frame(6)
    bench.end("s6", "disk_full")
    bench.recorder.stop("rec-2", "cam0", "stop")
    (last,) = bench.recorder.ledger_orders()
    assert last.ended
    assert last.account.refused == {"no_object": 1, "backlog_full": 1, "disk_full": 1}
    assert last.account.dropped == {"label": 2, "detect": 1}
    assert last.account.settled
    bench.recorder.ledger_answered(Answer(key=last.key))
    assert [answer.key for answer in bench.answers] == ["stop"]
    assert bench.answers[0].ledgers[0].phase == "ended"
    assert bench.recorder.settled


def test_every_s_takes_frames_on_a_grid(bench: Bench) -> None:
    bench.recorder.start(start(every_s=1.0))
    base = 10**12
    for index in range(31):
        bench.frame(index + 1, mono_ns=base + index * 100_000_000)
        for name in list(bench.begun):
            bench.end(name)
    (state,) = bench.recorder.states()
    ledger = state.ledger.cameras["cam0"]
    assert ledger.recorded == 4
    assert ledger.refused == {"not_due": 27}


def test_until_count_waits_for_durable_samples_and_replaces_refused_ones(bench: Bench) -> None:
    bench.recorder.start(start(until_count=2))
    for count in (1, 2, 3):
        bench.frame(count)
    assert list(bench.begun) == ["s1", "s2"]
    bench.end("s1", "ambiguous_pose")
    bench.end("s2")
    bench.tick()
    assert bench.recorder.recordings["rec-2", "cam0"].phase == "running"
    bench.frame(4)
    bench.end("s4")
    bench.tick()
    assert bench.recorder.recordings["rec-2", "cam0"].phase == "finishing"


def test_the_store_is_told_only_what_changed_one_order_at_a_time(bench: Bench) -> None:
    bench.recorder.start(start())
    bench.frame(1, objects=0)
    (first,) = bench.recorder.ledger_orders()
    bench.frame(2, objects=0)
    assert list(bench.recorder.ledger_orders()) == []
    bench.recorder.ledger_answered(Answer(key=first.key))
    (second,) = bench.recorder.ledger_orders()
    assert second.account.captured == 2
    bench.recorder.ledger_answered(Answer(key=second.key))
    assert list(bench.recorder.ledger_orders()) == []


def test_going_down_answers_everybody(bench: Bench) -> None:
    bench.recorder.record(order())
    bench.recorder.start(start())
    bench.frame(1)
    bench.recorder.finish_all("the stack was stopped")
    assert bench.answers[0].pending == ("s1",)
    assert bench.answers[0].error is not None
    assert bench.answers[0].error.code == "stopping"
    assert "when tagmill was stopped" in bench.answers[0].error.message
    assert not bench.recorder.settled
    bench.end("s1")
    for ledger in list(bench.recorder.ledger_orders()):
        bench.recorder.ledger_answered(Answer(key=ledger.key))
    assert bench.recorder.settled


def test_a_repeated_order_after_its_answer_gets_the_same_answer_and_no_further_sample(bench: Bench) -> None:
    bench.recorder.record(order())
    bench.frame(1)
    bench.end("s1")
    bench.tick()
    list(bench.recorder.ledger_orders())
    bench.recorder.record(order())
    bench.frame(2)
    assert not bench.begun
    assert [answer.samples for answer in bench.answers] == [("s1",), ("s1",)]


def test_a_closing_account_that_the_store_refuses_is_told_again_and_the_stop_says_so(bench: Bench) -> None:
    bench.recorder.start(start())
    bench.frame(1, objects=0)
    bench.recorder.stop("rec-2", "cam0", "stop")
    (first,) = bench.recorder.ledger_orders()
    bench.recorder.ledger_answered(Answer(key=first.key, error=ErrorInfo(code="no_dataset", message="gone")))
    assert bench.answers[0].error is not None
    assert bench.recorder.recordings["rec-2", "cam0"].phase == "finishing"
    assert list(bench.recorder.ledger_orders()) == [], "not at once"
    deadline = time.monotonic() + 10
    while not (again := list(bench.recorder.ledger_orders())):
        assert time.monotonic() < deadline
    bench.recorder.ledger_answered(Answer(key=again[0].key))
    assert bench.recorder.recordings["rec-2", "cam0"].phase == "ended"


def test_a_frame_of_the_past_goes_to_the_request_that_asked_for_it_only(bench: Bench) -> None:
    bench.frame(4)
    bench.recorder.start(start())
    request = bench.recorder.record(order(frame=4))
    assert request is not None
    bench.recorder.past_frame(request, detections(4), seen(objects=1), bench.begin)
    assert bench.begun == {"s4": [request]}
    assert bench.recorder.recordings["rec-2", "cam0"].account.captured == 0
    bench.end("s4")
    assert request.account.ledger().settled


class Thing(SimpleNamespace):
    """An object straight ahead, as far as `Views` looks at it."""

    name = "box"
    quality = SimpleNamespace(reprojection_error_px=0.1, ambiguous=False)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1000.0])).label()


def test_auto_takes_a_view_once_even_while_its_sample_is_on_its_way(bench: Bench) -> None:
    spec = RecordingSpec(recording="rec-2", mode="auto", cameras=("cam0",), started_at="now")
    bench.recorder.start(StartOrder(key="start", spec=spec, camera="cam0"))
    still = SimpleNamespace(objects=(Thing(),), left_out=(), missing=())
    for count in range(1, 6):
        bench.recorder.frame(detections(count), still, bench.begin)  # type: ignore[arg-type]
    assert list(bench.begun) == ["s1"]
    bench.end("s1", "ambiguous_pose")
    bench.recorder.frame(detections(6), still, bench.begin)  # type: ignore[arg-type]
    assert list(bench.begun) == ["s6"], "a refused view is wanted again"
