"""The hops of a frame's way, from messages with known times."""

import pytest

from common.messages import FrameRef
from tools.bench.load_hops import HOPS, FrameHops

MS = 1_000_000


def ref(frame: int, captured_ns: int) -> FrameRef:
    return FrameRef(
        camera="cam0",
        boot="b",
        ring="r",
        frame=frame,
        count=frame,
        captured_mono_ns=captured_ns,
        captured_wall_ns=0,
    )


def way(hops: FrameHops, frame: int, took: tuple[int, ...]) -> None:
    """Tell of one frame whose hops took so many ms."""
    begun = frame * 1000 * MS
    one = ref(frame, begun)
    ends = [begun + MS * sum(took[: hop + 1]) for hop in range(len(took))]
    hops.announced(one, ends[0])
    hops.detected(one, ends[2], took[2] * MS)
    hops.labelled(one, ends[4], took[4] * MS)


def test_the_hops_of_a_way_are_told_apart() -> None:
    hops = FrameHops()
    way(hops, 1, (1, 2, 3, 4, 5))
    assert {name: hop.mean_ms for name, hop in hops.result().items()} == dict(zip(HOPS, (1, 2, 3, 4, 5), strict=True))


def test_of_the_slowest_frames_it_is_said_where_they_were_slow() -> None:
    hops = FrameHops()
    for frame in range(1, 200):
        way(hops, frame, (1, 1, 2, 1, 5))
    way(hops, 200, (1, 1, 2, 40, 5))
    found = hops.result()
    assert found["to label"].slowest_mean_ms > 20
    assert found["to label"].p50_ms == 1
    assert found["detect"].slowest_mean_ms == pytest.approx(2)


def test_a_frame_whose_announcement_was_missed_is_left_out() -> None:
    hops = FrameHops()
    hops.detected(ref(1, 0), 5, 1)
    hops.labelled(ref(1, 0), 9, 2)
    assert hops.result() == {}
