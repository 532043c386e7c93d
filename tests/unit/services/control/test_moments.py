"""Frames of several cameras that were taken at the same moment, as nearly as can be."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from common.ids import is_sample_name
from common.messages import FrameRef, Labels
from services.control.moments import Moment, Moments

MS = 1_000_000
WALL = 1_800_000_000_000_000_000


def labels(camera: str, frame: int, at_ns: int, boot: str = "b1") -> Labels:
    ref = FrameRef(
        camera=camera,
        boot=boot,
        ring="r",
        frame=frame,
        count=frame,
        captured_mono_ns=at_ns,
        captured_wall_ns=WALL + at_ns,
    )
    return Labels(ref=ref, objects=(), left_out=(), took_ns=1)


def hear(moments: Moments, camera: str, *times_ms: float) -> None:
    for frame, at_ms in enumerate(times_ms, 1):
        moments.hear(labels(camera, frame, int(at_ms * MS)))


def any_fits(_: Moment) -> bool:
    return True


def numbers(moments: Moments, since_ms: float = 0) -> dict[str, int] | None:
    chosen = moments.chosen(("a", "b"), int(since_ms * MS), any_fits)
    return None if chosen is None else {name: moment.frame for name, moment in chosen.moments.items()}


def test_the_slower_cameras_frame_and_the_nearest_of_the_other() -> None:
    moments = Moments()
    hear(moments, "a", 0, 100, 200)
    hear(moments, "b", 3, 33, 66, 99, 132, 165, 198)
    assert numbers(moments, 50) == {"a": 2, "b": 4}
    chosen = moments.chosen(("a", "b"), 50 * MS, any_fits)
    assert chosen is not None
    of_a, of_b = chosen.pair_of("a"), chosen.pair_of("b")
    assert (of_a.reference, of_a.offset_ms, of_a.spread_ms) == ("a", 0.0, 1.0)
    assert (of_b.reference, of_b.offset_ms, of_b.spread_ms) == ("a", -1.0, 1.0)
    assert of_a.samples == of_b.samples
    assert all(is_sample_name(name) for name in of_a.samples.values())


def test_a_nearer_one_may_still_come_and_is_waited_for() -> None:
    moments = Moments()
    hear(moments, "a", 0, 100)
    hear(moments, "b", 20, 53, 86)
    assert numbers(moments, 50) is None
    moments.hear(labels("b", 4, 119 * MS))
    assert numbers(moments, 50) == {"a": 2, "b": 3}


def test_frames_from_before_are_not_taken_nor_those_that_do_not_fit() -> None:
    moments = Moments()
    hear(moments, "a", 0, 100, 200)
    hear(moments, "b", 99, 140, 201, 240)
    assert numbers(moments, 99.5) == {"a": 3, "b": 3}
    chosen = moments.chosen(("a", "b"), 0, lambda moment: (moment.camera, moment.frame) != ("b", 1))
    assert chosen is not None
    assert chosen.moments["a"].frame == 3
    assert moments.fitting(("a", "b", "c"), 210 * MS, any_fits) == ("b",)


def test_a_camera_that_is_silent_or_new_has_no_moment() -> None:
    moments = Moments()
    hear(moments, "a", 0, 100)
    assert numbers(moments) is None
    hear(moments, "b", 0, 100)
    moments.hear(labels("b", 1, 150 * MS, boot="b2"))
    assert moments.recent(("a", "b"), 120 * MS) == ("b",)
    assert moments.chosen(("b",), 0, any_fits) is not None
    assert numbers(moments) is None, "what the camera took in an earlier life is gone"


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(15, 120), st.floats(0, 120)), min_size=2, max_size=4), st.floats(0, 300))
def test_no_other_frame_is_nearer_and_the_spread_is_that_of_the_frames(
    cameras: list[tuple[float, float]], since_ms: float
) -> None:
    moments = Moments()
    taken: dict[str, list[int]] = {}
    for number, (period_ms, phase_ms) in enumerate(cameras):
        name = f"cam{number}"
        taken[name] = [int((phase_ms + step * period_ms) * MS) for step in range(32) if step * period_ms < 900]
        for frame, at_ns in enumerate(taken[name], 1):
            moments.hear(labels(name, frame, at_ns))
    since_ns = int(since_ms * MS)
    chosen = moments.chosen(tuple(taken), since_ns, any_fits)
    if chosen is None:
        return
    for name, moment in chosen.moments.items():
        assert moment.mono_ns >= since_ns
        assert abs(moment.mono_ns - chosen.at_ns) == min(abs(at_ns - chosen.at_ns) for at_ns in taken[name][-32:])
    times = [moment.mono_ns for moment in chosen.moments.values()]
    assert chosen.pair_of("cam0").spread_ms == (max(times) - min(times)) / MS
