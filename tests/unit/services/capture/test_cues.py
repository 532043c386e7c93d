"""When a file camera plays, and what a paced one waits for."""

from __future__ import annotations

import threading
from typing import Any

from common.ledgers import Ledger, RecordingSpec
from common.messages import FrameRef, RecordingState
from services.capture.cues import Cues


def recording(name: str, phase: Any = "running", mode: Any = "all") -> RecordingState:
    spec = RecordingSpec(recording=name, mode=mode, cameras=("cam0",), started_at="")
    return RecordingState(camera="cam0", ledger=Ledger(spec=spec, phase=phase, cameras={}))


def frame(number: int, boot: str = "b") -> FrameRef:
    return FrameRef(
        camera="cam0", boot=boot, ring="r", frame=number, count=number, captured_mono_ns=0, captured_wall_ns=0
    )


def test_each_recording_is_played_once_however_often_it_is_told() -> None:
    cues = Cues("b")
    assert cues.wait_play(0) is None
    for name in ("one", "two"):
        for _ in range(3):
            cues.on_recording(recording(name))
        assert cues.wait_play(0) == name
        cues.on_recording(recording(name))
        assert cues.wait_play(0) is None


def test_all_and_auto_play_record_does_not() -> None:
    cues = Cues("b")
    cues.on_recording(recording("one", mode="record"))
    assert cues.wait_play(0) is None
    cues.on_recording(recording("two", mode="auto"))
    assert cues.wait_play(0) == "two"


def test_a_recording_that_is_over_is_not_played() -> None:
    cues = Cues("b")
    cues.on_recording(recording("one", "ended"))
    assert cues.wait_play(0) is None
    cues.on_recording(recording("one"))
    cues.on_recording(recording("one", "finishing"))
    assert cues.wait_play(0) is None


def test_the_end_of_the_recording_that_is_played_breaks_it_off() -> None:
    cues = Cues("b")
    cues.on_recording(recording("one"))
    cues.wait_play(0)
    cues.on_recording(recording("other", "ended"))
    assert not cues.cut()
    cues.on_recording(recording("one", "interrupted"))
    assert not cues.cut(), "an interrupted recording goes on when its label process is back"
    cues.on_recording(recording("one", "finishing"))
    assert cues.cut()
    cues.on_recording(recording("two"))
    assert cues.wait_play(0) == "two"
    assert not cues.cut()


def test_a_recording_that_begins_meanwhile_gets_its_turn() -> None:
    cues = Cues("b")
    cues.on_recording(recording("one"))
    assert cues.wait_play(0) == "one"
    cues.on_recording(recording("two"))
    assert not cues.cut()
    assert cues.wait_play(0) == "two"


def test_a_label_of_this_life_and_this_frame_or_a_later_one_is_waited_for() -> None:
    cues = Cues("b")
    cues.on_labelled(frame(9, boot="another"))
    cues.on_labelled(frame(4))
    assert not cues.wait_label(5, 0)
    cues.on_labelled(frame(5))
    assert cues.wait_label(5, 0)
    cues.on_labelled(frame(2))
    assert cues.wait_label(5, 0)


def test_every_wait_ends_with_stop() -> None:
    cues = Cues("b")
    ended: list[str] = []
    threads = [
        threading.Thread(target=lambda wait=wait, name=name: (wait(), ended.append(name)))  # type: ignore[misc]
        for name, wait in (
            ("stop", lambda: cues.wait_stop(60)),
            ("play", lambda: cues.wait_play(60)),
            ("label", lambda: cues.wait_label(1, 60)),
        )
    ]
    for thread in threads:
        thread.start()
    cues.stop()
    for thread in threads:
        thread.join(10)
    assert sorted(ended) == ["label", "play", "stop"]
    assert cues.stopping()
    assert cues.cut()
