"""Frame rings and sample rings within one process."""

from __future__ import annotations

import errno
import itertools
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.errors import FrameLostError, NameTakenError, NoSpaceError
from common.frames import FrameReader, FrameWriter, Layout, SampleRing, SampleSlots, segment_name, shm_folder, sweep
from common.frames.layout import LINE, PAGE
from common.frames.segment import Segment
from tests.support.hygiene import Place

WIDTH, HEIGHT, SLOTS = 33, 17, 4  # odd on purpose: nothing is aligned by luck


@pytest.fixture
def name(place: Place) -> str:
    return segment_name(place.prefix, "cam0", "00000001")


def picture(value: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), value, np.uint8)


def distances(value: int) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), value, np.uint16)


def test_a_frame_comes_out_as_it_went_in(name: str) -> None:
    chance = np.random.default_rng(1)
    bgr = chance.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    depth = chance.integers(0, 65536, (HEIGHT, WIDTH), np.uint16)
    with FrameWriter(name, WIDTH, HEIGHT, True, SLOTS) as ring, FrameReader(name) as reader:
        assert reader.newest() == 0
        assert ring.write(bgr, depth) == 1
        assert reader.newest() == ring.newest == 1
        with reader.view(1) as frame:
            assert np.array_equal(frame.bgr, bgr)
            assert frame.depth is not None
            assert np.array_equal(frame.depth, depth)
            assert not frame.bgr.flags.writeable
            assert frame.bgr.flags.c_contiguous


def test_a_ring_without_depth_has_none_and_takes_none(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        ring.write(picture(1))
        with reader.view(1) as frame:
            assert frame.depth is None
        with pytest.raises(ValueError, match="without depth"):
            ring.write(picture(1), distances(1))


def test_a_missing_depth_picture_is_invalid_everywhere_not_the_one_before(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, True, 2) as ring, FrameReader(name) as reader:
        for _ in range(3):
            ring.write(picture(1), distances(700))
        number = ring.write(picture(2), None)
        with reader.view(number) as frame:
            assert frame.depth is not None
            assert not frame.depth.any()


def test_the_newest_slots_minus_one_frames_are_there(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        for value in range(10):
            ring.write(picture(value))
        for number in (8, 9, 10):
            with reader.view(number) as frame:
                assert (frame.bgr == number - 1).all()
        for number in (-1, 0, 1, 6, 7, 11, 14):
            with (
                pytest.raises(FrameLostError, match=f"frame {number} is not in the ring .* holds 8 to 10"),
                reader.view(number),
            ):
                pytest.fail("it let us in")


def test_overwritten_while_it_is_looked_at_is_lost(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        ring.write(picture(1))
        for further in range(SLOTS - 2):
            ring.write(picture(2 + further))
        with reader.view(1) as frame:
            assert (frame.bgr == 1).all()
        with pytest.raises(FrameLostError), reader.view(1):
            ring.write(picture(9))  # its slot is the next: invalid before it is written


def test_a_frame_is_lost_from_the_moment_its_slot_is_written(name: str) -> None:
    def fill(bgr: np.ndarray, depth: np.ndarray | None) -> None:
        bgr[: HEIGHT // 2] = 200
        for number in (ring.newest + 1, ring.newest + 1 - SLOTS):
            with pytest.raises(FrameLostError), reader.view(number):
                pytest.fail("half a frame was shown")
        bgr[:] = 200

    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        for value in range(SLOTS + 1):
            ring.write(picture(value))
        number = ring.write(None, fill=fill)
        with reader.view(number) as frame:
            assert (frame.bgr == 200).all()


def test_a_frame_whose_filling_fails_was_never_there(name: str) -> None:
    def fill(bgr: np.ndarray, depth: np.ndarray | None) -> None:
        bgr[:] = 99
        raise RuntimeError("the renderer broke")

    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        ring.write(picture(1))
        with pytest.raises(RuntimeError, match="broke"):
            ring.write(None, fill=fill)
        assert reader.newest() == 1
        with pytest.raises(FrameLostError), reader.view(2):
            pytest.fail("it let us in")
        assert ring.write(picture(3)) == 2
        with reader.view(2) as frame:
            assert (frame.bgr == 3).all()


def test_numbers_go_on_in_a_second_ring(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS, first=41) as ring, FrameReader(name) as reader:
        assert (ring.newest, reader.newest()) == (40, 0)
        assert ring.write(picture(5)) == 41
        with reader.view(41) as frame:
            assert (frame.bgr == 5).all()


def test_an_error_in_the_block_is_told_as_it_is(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        ring.write(picture(1))
        with pytest.raises(ZeroDivisionError), reader.view(1):
            _ = 1 // 0


def test_a_view_is_used_inside_its_block_only(name: str) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring, FrameReader(name) as reader:
        ring.write(picture(1))
        view = reader.view(1)
        with pytest.raises(RuntimeError, match="inside its with block"):
            _ = view.bgr
        with view:
            assert view.bgr.any()
        with pytest.raises(RuntimeError, match="inside its with block"):
            _ = view.bgr


@pytest.mark.parametrize(
    ("bgr", "depth"),
    [
        (None, None),
        (np.zeros((HEIGHT, WIDTH), np.uint8), None),
        (np.zeros((WIDTH, HEIGHT, 3), np.uint8), None),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint16), None),
        (picture(0), np.zeros((HEIGHT, WIDTH), np.float32)),
        (picture(0), np.zeros((HEIGHT, WIDTH + 1), np.uint16)),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(name: str, bgr: np.ndarray, depth: np.ndarray) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, True, SLOTS) as ring:
        with pytest.raises(ValueError, match="takes"):
            ring.write(bgr, depth)
        assert ring.newest == 0


def test_the_segment_is_private_and_goes_with_its_owner(name: str) -> None:
    ring = FrameWriter(name, WIDTH, HEIGHT, False, SLOTS)
    path = shm_folder() / name
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.stat().st_blocks * 512 >= ring.layout.size, "allocated now, not when it is written"
    with pytest.raises(NameTakenError):
        FrameWriter(name, WIDTH, HEIGHT, False, SLOTS)
    reader = FrameReader(name)
    ring.write(picture(7))
    ring.close()
    ring.close()
    assert not path.exists()
    with reader.view(1) as frame:
        assert (frame.bgr == 7).all(), "who has it mapped keeps it"
    reader.close()
    reader.close()
    with pytest.raises(FrameLostError, match="closed"):
        reader.newest()
    with pytest.raises(FrameLostError, match="is gone"):
        FrameReader(name)


def test_an_array_that_outlives_its_ring_is_still_memory(name: str) -> None:
    ring, reader = FrameWriter(name, WIDTH, HEIGHT, False, SLOTS), FrameReader(name)
    ring.write(picture(7))
    with reader.view(1) as frame:
        kept = frame.bgr
    reader.close()
    ring.close()
    assert (kept == 7).all()


def test_too_large_is_told_with_the_cure(name: str) -> None:
    with pytest.raises(NoSpaceError, match=r"needs [\d.]+ MB in .*, where [\d.]+ of .* MB are free.*--shm-size=\d+m"):
        FrameWriter(name, 60000, 60000, True, 4000)
    assert not (shm_folder() / name).exists()


def test_a_folder_that_is_not_there_is_told(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAGMILL_SHM_DIR", "/nonexistent/shm")
    with pytest.raises(NoSpaceError, match="/nonexistent/shm does not exist"):
        FrameWriter(name, WIDTH, HEIGHT, True, SLOTS)
    assert sweep("any") == []


@pytest.mark.parametrize("bad", ["../etc/passwd", "tagmill-a/b", "other-a-b-c", "", "tagmill-" + "x" * 300])
def test_a_name_from_a_message_is_never_a_path(bad: str) -> None:
    with pytest.raises(FrameLostError, match="no name of a segment"):
        FrameReader(bad)


@pytest.mark.parametrize("item", range(8))
def test_a_damaged_header_is_no_ring(name: str, item: int) -> None:
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS) as ring:
        ring._header[item] = 2**40 + 1
        with pytest.raises(FrameLostError):
            FrameReader(name)


@pytest.mark.parametrize("size", [0, 8, 128, 5000])
def test_a_foreign_file_is_no_ring(name: str, size: int) -> None:
    path = shm_folder() / name
    path.write_bytes(b"\xff" * size)
    try:
        with pytest.raises(FrameLostError):
            FrameReader(name)
    finally:
        path.unlink()


def test_one_kind_is_not_taken_for_the_other(name: str) -> None:
    with SampleRing(name, WIDTH, HEIGHT, False, SLOTS), pytest.raises(FrameLostError, match="not a ring of frames"):
        FrameReader(name)
    with FrameWriter(name, WIDTH, HEIGHT, False, SLOTS), pytest.raises(FrameLostError, match="not a ring of samples"):
        SampleSlots(name)


def test_sweep_takes_the_dead_of_its_prefix_only(place: Place) -> None:
    mine, others = segment_name(place.prefix, "cam0", "1"), segment_name(f"{place.prefix}x", "cam0", "1")
    for name in (mine, others):
        (shm_folder() / name).write_bytes(b"dead")
    try:
        assert sweep(place.prefix, "cam1") == []
        assert sweep(place.prefix) == [mine]
        assert sweep(place.prefix) == []
        assert sweep(f"{place.prefix}x") == [others]
    finally:
        for name in (mine, others):
            (shm_folder() / name).unlink(missing_ok=True)


def test_slots_of_samples_are_lent_until_released(name: str) -> None:
    with SampleRing(name, WIDTH, HEIGHT, True, 3, with_original=True) as ring:
        taken = [ring.acquire() for _ in range(3)]
        assert sorted(slot for slot in taken if slot is not None) == [0, 1, 2]
        assert ring.free == 0
        assert ring.acquire() is None
        ring.release(1)
        assert ring.free == 1
        for wrong in (1, 3, -1):
            with pytest.raises(ValueError, match="is not acquired"):
                ring.release(wrong)
            with pytest.raises(ValueError, match="is not acquired"):
                ring.view(wrong)
        assert ring.acquire() == 1


def test_a_slot_of_samples_gets_its_memory_when_it_is_first_taken(name: str) -> None:
    with SampleRing(name, 640, 480, True, 3) as ring:
        taken = []
        for _ in range(3):
            taken.append((shm_folder() / name).stat().st_blocks * 512)
            assert ring.acquire() is not None
        assert [(later - taken[0]) // ring.layout.slot_bytes for later in taken] == [0, 1, 2]
        ring.release(1)
        ring.acquire()
        assert (shm_folder() / name).stat().st_blocks * 512 <= ring.layout.size


def test_a_slot_without_memory_is_refused_and_stays_free(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_descriptor: int, _start: int, _count: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with SampleRing(name, WIDTH, HEIGHT, True, 2) as ring:
        with monkeypatch.context() as others:
            others.setattr(os, "posix_fallocate", full)
            with pytest.raises(NoSpaceError, match="shared memory is full"):
                ring.acquire()
        assert ring.free == 2
        assert ring.acquire() == 0


def test_samples_are_seen_and_changed_by_the_eraser_and_only_read_by_the_store(name: str) -> None:
    with SampleRing(name, WIDTH, HEIGHT, True, 3, with_original=True) as ring:
        slot = ring.acquire()
        assert slot is not None
        own = ring.view(slot)
        assert own.depth is not None
        assert own.original is not None
        own.bgr[:], own.depth[:], own.original[:] = 1, 2, 3
        with SampleSlots(name, writable=True) as eraser, SampleSlots(name) as store:
            eraser.view(slot).bgr[5] = 77
            seen = store.view(slot)
            assert seen.depth is not None
            assert seen.original is not None
            assert (seen.bgr[5] == 77).all()
            assert (seen.bgr[:5] == 1).all()
            assert (seen.depth == 2).all()
            assert (seen.original == 3).all()
            for array in (seen.bgr, seen.depth, seen.original):
                with pytest.raises(ValueError, match="read-only"):
                    array[:] = 0
            with pytest.raises(FrameLostError, match="no slot 3"):
                store.view(3)


def test_samples_stay_readable_when_the_owner_is_gone(name: str) -> None:
    ring = SampleRing(name, WIDTH, HEIGHT, False, 1)
    slot = ring.acquire()
    assert slot is not None
    ring.view(slot).bgr[:] = 9
    with SampleSlots(name) as store:
        ring.close()
        assert (store.view(slot).bgr == 9).all()
        assert store.view(slot).depth is None
        assert store.view(slot).original is None


@settings(max_examples=200, deadline=None)
@given(
    kind=st.sampled_from(["frames", "samples"]),
    width=st.integers(1, 500),
    height=st.integers(1, 500),
    slots=st.integers(2, 20),
    depth=st.booleans(),
    original=st.booleans(),
)
def test_pictures_are_aligned_and_apart(
    kind: str, width: int, height: int, slots: int, depth: bool, original: bool
) -> None:
    layout = Layout(kind, width, height, slots, depth, original)  # type: ignore[arg-type]
    memory = np.zeros(layout.size + PAGE, np.uint8)
    start = -memory.ctypes.data % PAGE
    buffer = memoryview(memory[start : start + layout.size])  # type: ignore[arg-type]
    arrays = [np.frombuffer(buffer, np.uint8, 128)]
    for numbers in layout.control(buffer):
        assert numbers.shape == (slots,)
        assert all(numbers[slot:].ctypes.data % 8 == 0 for slot in range(slots))
        arrays += [numbers[slot : slot + 1] for slot in range(slots)]
    for slot in range(slots):
        pictures = layout.pictures(buffer, slot)
        assert pictures.bgr.ctypes.data % PAGE == 0
        assert (pictures.depth is not None, pictures.original is not None) == (depth, original)
        for array in (pictures.bgr, pictures.depth, pictures.original):
            if array is not None:
                assert array.ctypes.data % LINE == 0
                arrays.append(array)
    spans = sorted((array.ctypes.data, array.ctypes.data + array.nbytes) for array in arrays)
    assert all(first[1] <= second[0] for first, second in itertools.pairwise(spans))
    assert spans[-1][1] <= memory.ctypes.data + start + layout.size


@pytest.mark.parametrize(("width", "height", "slots"), [(0, 1, 4), (1, 0, 4), (1 << 17, 1, 4), (8, 8, 1), (8, 8, 5000)])
def test_sizes_that_no_ring_has(name: str, width: int, height: int, slots: int) -> None:
    with pytest.raises(ValueError, match=r"pixels|slots"):
        FrameWriter(name, width, height, False, slots)


def test_a_720p_ring_with_depth_is_what_the_handbook_says() -> None:
    assert round(Layout("frames", 1280, 720, 12, True).size / 1e6) == 55
    assert round(Layout("samples", 1280, 720, 64, True).size / 1e6) == 295


def test_a_segment_of_a_closed_owner_says_so(name: str) -> None:
    with Segment.create(name, 4096) as segment:
        assert len(segment.buffer) == 4096
    assert segment.closed
    with pytest.raises(FrameLostError, match="is closed"):
        _ = segment.buffer
