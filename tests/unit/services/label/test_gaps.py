"""When a camera gave nothing during a recording."""

from __future__ import annotations

import pytest

from common.labels import CameraLabel
from common.ledgers import CameraLedger
from common.messages import CameraState, FrameRef
from common.messages.frames import CameraPhase
from services.label.account import Account
from services.label.gaps import LISTED, Gaps

S = 1_000_000_000
WALL = 1_800_000_000 * S
"""The wall clock where the monotonic one is 0."""


def ref(count: int, at_s: float, boot: str = "b1") -> FrameRef:
    mono = int(at_s * S)
    return FrameRef(
        camera="cam0",
        boot=boot,
        ring="r",
        frame=count,
        count=count,
        captured_mono_ns=mono,
        captured_wall_ns=WALL + mono,
    )


def state(
    phase: CameraPhase, newest_s: float, error: str | None = None, boot: str = "b1", **more: object
) -> CameraState:
    camera = CameraLabel(name="cam0", width=4, height=4, matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1)), distortion=())
    return CameraState.model_validate(
        {"boot": boot, "phase": phase, "driver": "d", "ring": "r", "camera": camera, "fps": 10.0}
        | {"newest_mono_ns": int(newest_s * S), "last_error": error}
        | more
    )


def tell(gaps: Gaps, said: CameraState, at_s: float) -> None:
    gaps.hear(said, int(at_s * S), WALL + int(at_s * S))


def found(gaps: Gaps) -> list[tuple[float, float | None, str]]:
    return [((gap.since_wall_ns - WALL) / S, gap.seconds, gap.reason) for gap in gaps.listed]


def test_frames_that_come_in_time_leave_no_gap() -> None:
    gaps = Gaps(CameraLedger())
    for step in range(50):
        tell(gaps, state("streaming", step / 10), step / 10)
        gaps.frame(ref(step + 1, step / 10), 0)
    gaps.finish(5 * S, WALL + 5 * S)
    assert gaps.listed == ()


def test_a_camera_that_is_lost_has_a_gap_from_its_last_frame_to_its_next() -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("streaming", 0), 0)
    gaps.frame(ref(1, 1.0), 0)
    tell(gaps, state("lost", 1.1, "unplugged"), 2.0)
    assert found(gaps) == [(1.1, None, "unplugged")], "while it lasts"
    gaps.frame(ref(2, 1.1), 0)
    assert found(gaps) == [(1.1, None, "unplugged")], "taken before, labelled after"
    gaps.frame(ref(3, 6.3), 0)
    tell(gaps, state("lost", 1.1, "unplugged"), 6.4)
    assert found(gaps) == [(1.1, 5.2, "unplugged")], "the state that was said before the frame is old"
    (gap,) = gaps.listed
    assert (gap.since, gap.to) == ("2027-01-15T08:00:01.100Z", "2027-01-15T08:00:06.300Z")


def test_a_process_that_died_says_nothing_but_its_frames_do() -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("streaming", 0), 0)
    gaps.frame(ref(7, 1.0), 0)
    tell(gaps, state("lost", 0.0, "not there yet", boot="b2"), 3.0)
    gaps.frame(ref(1, 4.0, "b2"), 0)
    gaps.frame(ref(1, 9.0, "b3"), 0)
    assert found(gaps) == [(1.0, 3.0, "not there yet"), (4.0, 5.0, "its capture process was started again")]


def test_frames_that_others_lost_are_no_gap_of_the_camera() -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("streaming", 0), 0)
    gaps.frame(ref(1, 1.0), 0)
    gaps.frame(ref(31, 4.0), 29)
    assert gaps.listed == ()


def test_a_camera_that_is_away_at_the_end_was_so_until_then() -> None:
    for last in (state("lost", 1.0, "gone"), None):
        gaps = Gaps(CameraLedger())
        tell(gaps, state("streaming", 0), 0)
        gaps.frame(ref(1, 1.0), 0)
        if last is not None:
            tell(gaps, last, 2.0)
        gaps.finish(8 * S, WALL + 8 * S)
        assert [(since, seconds) for since, seconds, _ in found(gaps)] == [(1.0, 7.0)]


def test_a_camera_that_is_away_at_the_start_is_so_from_then() -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("lost", 1.0, "gone"), 5.0)
    gaps.frame(ref(9, 7.5), 0)
    assert found(gaps) == [(5.0, 2.5, "gone")]


@pytest.mark.parametrize("more", [{"paced": True}, {"played_for": "rec"}])
def test_files_that_are_played_have_no_gaps(more: dict[str, object]) -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("streaming", 0, **more), 0)
    gaps.frame(ref(1, 1.0), 0)
    gaps.frame(ref(2, 9.0), 0)
    gaps.finish(20 * S, WALL + 20 * S)
    assert gaps.listed == ()


def test_gaps_outlive_a_restart_of_label_also_an_open_one() -> None:
    first = Account()
    tell(first.gaps, state("streaming", 0), 0)
    first.arrived(ref(1, 1.0))
    first.arrived(ref(2, 4.0))
    tell(first.gaps, state("lost", 4.0, "gone"), 5.0)
    again = Account(CameraLedger.model_validate_json(first.ledger().model_dump_json(by_alias=True)))
    tell(again.gaps, state("lost", 4.0, "gone"), 6.0)
    again.arrived(ref(3, 9.0))
    assert [(since, seconds) for since, seconds, _ in found(again.gaps)] == [(1.0, 3.0), (4.0, 5.0)]


def test_a_loose_cable_does_not_fill_the_ledger() -> None:
    gaps = Gaps(CameraLedger())
    tell(gaps, state("streaming", 0), 0)
    for step in range(LISTED + 6):
        gaps.frame(ref(step + 1, step * 3), 0)
    assert (len(gaps.listed), gaps.unlisted) == (LISTED, 5)
