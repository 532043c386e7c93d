"""A frame is drawn with its own label, or without any; never with another's."""

from __future__ import annotations

from common.messages import FrameRef, Labels
from services.console.join import SILENT_NS, WAIT_NS, Join

MS = 1_000_000


def ref(frame: int, boot: str = "a", at_ms: int | None = None) -> FrameRef:
    captured = (frame * 33 if at_ms is None else at_ms) * MS
    return FrameRef(
        camera="cam0", boot=boot, ring="r", frame=frame, count=frame, captured_mono_ns=captured, captured_wall_ns=0
    )


def labels(frame: int, boot: str = "a") -> Labels:
    return Labels(ref=ref(frame, boot), objects=())


def warm() -> Join:
    """One that has heard a label."""
    join = Join()
    assert join.labels(labels(1), 40 * MS) is not None
    return join


def test_a_frame_waits_for_its_label_and_is_drawn_with_it() -> None:
    join = warm()
    assert join.frame(ref(2), 67 * MS) is None
    joined = join.labels(labels(2), 76 * MS)
    assert joined is not None
    assert joined.labels is not None
    assert joined.ref.frame == joined.labels.ref.frame == 2
    assert join.next_due_ns() is None


def test_after_120_ms_the_newest_that_waited_so_long_is_drawn_without() -> None:
    join = warm()
    for frame in (2, 3, 4, 5):
        assert join.frame(ref(frame), ref(frame).captured_mono_ns + MS) is None
    assert join.next_due_ns() == ref(2).captured_mono_ns + WAIT_NS
    assert join.due(ref(2).captured_mono_ns + WAIT_NS - 1) is None
    joined = join.due(ref(3).captured_mono_ns + WAIT_NS)
    assert joined is not None
    assert (joined.ref.frame, joined.labels) == (3, None)
    assert join.next_due_ns() == ref(4).captured_mono_ns + WAIT_NS


def test_a_label_that_comes_after_its_frame_was_drawn_is_late_and_belongs_to_nobody() -> None:
    join = warm()
    join.frame(ref(2), 67 * MS)
    assert join.due(ref(2).captured_mono_ns + WAIT_NS) is not None
    assert join.labels(labels(2), ref(2).captured_mono_ns + WAIT_NS + 1) is None
    assert join.late == 1


def test_frames_are_drawn_in_order() -> None:
    join = warm()
    assert join.labels(labels(5), 180 * MS) is not None
    assert join.labels(labels(4), 181 * MS) is None
    assert join.frame(ref(4), 182 * MS) is None
    assert join.next_due_ns() is None


def test_without_any_labels_no_frame_waits() -> None:
    join = Join()
    joined = join.frame(ref(1), 34 * MS)
    assert joined is not None
    assert joined.labels is None
    late = warm()
    joined = late.frame(ref(60), 40 * MS + SILENT_NS + 1)
    assert joined is not None, "labels stopped a second ago"


def test_a_restarted_camera_counts_anew() -> None:
    join = warm()
    join.labels(labels(900), 30_000 * MS)
    joined = join.labels(labels(1, boot="b"), 30_040 * MS)
    assert joined is not None
    assert joined.ref.boot == "b"
    assert join.of(ref(900)) is not None, "an erased picture of the life before may still come"
    assert join.of(ref(1, boot="c")) is None
