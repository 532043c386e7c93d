"""The list of a session's samples: order, pages, filters, and what a label says of the view."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from common.dataset import label_path
from common.dataset.bin import delete, restore
from common.dataset.listing import SampleIndex, item_of, item_of_label
from common.labels import Label, Uncertainty
from common.messages import SampleFilter, SampleItem, decode, encode
from common.messages.orders import Answer
from tests.support.samples import camera_label, label_for, object_label
from tests.support.sessions import frames, make_session


def test_newest_first_in_pages(tmp_path: Path) -> None:
    names = make_session(tmp_path / "monday", *frames(*range(1, 8)))
    index = SampleIndex(tmp_path / "monday")
    index.build()
    first = index.page(SampleFilter(), 0, 3)
    assert [item.name for item in first.samples] == list(reversed(names))[:3]
    assert (first.total, first.stored, first.in_bin, first.next_offset) == (7, 7, 0, 3)
    last = index.page(SampleFilter(), 6, 3)
    assert ([item.name for item in last.samples], last.next_offset) == ([names[0]], None)
    assert index.page(SampleFilter(), 70, 3).samples == ()
    counts = index.page(SampleFilter(), 0, 0)
    assert (counts.samples, counts.total, counts.next_offset) == ((), 7, None)


def test_the_index_follows_the_bin(tmp_path: Path) -> None:
    session = tmp_path / "monday"
    one, two = make_session(session, *frames(1, 2))
    index = SampleIndex(session)
    index.build()
    delete(session, [one])
    index.refresh(one)
    assert [item.name for item in index.page(SampleFilter(), 0, 9).samples] == [two]
    (binned,) = index.page(SampleFilter(bin=True), 0, 9).samples
    assert binned.name == one
    assert all((session / path).is_file() for path in binned.files.values())
    assert set(binned.files) == {"rgb", "depth", "original"}
    restore(session, [one])
    index.refresh(one)
    assert index.page(SampleFilter(bin=True), 0, 9).total == 0
    (session / label_path(two)).unlink()
    index.refresh(two)
    assert [item.name for item in index.page(SampleFilter(), 0, 9).samples] == [one]


def test_a_stored_sample_is_listed_as_its_file_says_without_reading_it(tmp_path: Path) -> None:
    session = tmp_path / "monday"
    one, two = make_session(session, *frames(1, 2))
    read, told = SampleIndex(session), SampleIndex(session)
    read.build()
    for sample in (one, two):
        label = Label.model_validate_json((session / label_path(sample)).read_bytes())
        assert label.files is not None
        files = {kind: file.path for kind, file in label.files if file is not None}
        told.add(item_of_label(label.model_copy(update={"files": None}), files))
    assert told.page(SampleFilter(), 0, 9) == read.page(SampleFilter(), 0, 9)
    delete(session, [two])
    told.refresh(two)
    assert [item.name for item in told.page(SampleFilter(), 0, 9).samples] == [one]


def labels() -> tuple[Label, ...]:
    """Frame 1: box-0, 1000 mm. 2: box-1 of cam1, ambiguous. 3: of another recording, incomplete. 4: background."""
    one, two, three, four = (
        label_for(1),
        label_for(2, camera_label("cam1")),
        label_for(3, recording="rec-b"),
        label_for(4),
    )
    other = object_label(1)
    (side,) = other.sides
    sure = Uncertainty(distance_mm=2.5, rotation_deg=0.1, corners_px=())
    quality = other.quality.model_copy(update={"ambiguous": True, "reprojection_error_px": 1.5, "uncertainty": sure})
    other = other.model_copy(
        update={
            "type": "crate",
            "distance_mm": 2000.0,
            "quality": quality,
            "sides": (side, side, side.model_copy(update={"class_name": "lid"})),
        }
    )
    return (
        one,
        two.model_copy(update={"objects": (other,)}),
        three.model_copy(update={"complete": False}),
        four.model_copy(update={"objects": (), "background": True, "recording": None}),
    )


@pytest.mark.parametrize(
    ("wanted", "frames_found"),
    [
        ({}, [4, 3, 2, 1]),
        ({"object": "box-1"}, [2]),
        ({"object": "box-0", "type": "crate"}, []),
        ({"type": "crate"}, [2]),
        ({"side": "lid"}, [2]),
        ({"side": "front"}, [3, 2, 1]),
        ({"camera": "cam1"}, [2]),
        ({"recording": "rec-a"}, [2, 1]),
        ({"min_distance_mm": 1500}, [2]),
        ({"max_distance_mm": 1500.0}, [3, 1]),
        ({"max_reprojection_px": 0.5}, [3, 1]),
        ({"max_uncertainty_mm": 3.0}, [2]),
        ({"ambiguous": True}, [2]),
        ({"ambiguous": False}, [3, 1]),
        ({"complete": False}, [3]),
        ({"background": True}, [4]),
        ({"camera": "cam0", "side": "front", "max_distance_mm": 1500}, [3, 1]),
        ({"bin": True}, []),
    ],
)
def test_filters(tmp_path: Path, wanted: dict[str, Any], frames_found: list[int]) -> None:
    session = tmp_path / "monday"
    make_session(session, *labels())
    index = SampleIndex(session)
    index.build()
    assert [item.frame for item in index.page(SampleFilter(**wanted), 0, 100).samples] == frames_found


def test_an_item_says_what_the_label_says() -> None:
    label = labels()[1]
    (found,) = item_of(label.sample, stored(label)).objects
    assert (found.name, found.type, found.sides) == ("box-1", "crate", ("front", "lid"))
    assert (found.distance_mm, found.reprojection_error_px, found.uncertainty_mm) == (2000.0, 1.5, 2.5)
    assert (found.ambiguous, found.pose_source) == (True, "measured")
    # The pose has no rotation: the camera looks along Z, which is the object's up, from below.
    assert (found.azimuth_deg, found.elevation_deg) == (-26.57, -88.72)


def stored(label: Label) -> bytes:
    plain = json.loads(label.model_dump_json(by_alias=True))
    plain["files"] = {"rgb": {"path": "rgb/a.png", "size": 1, "sha256": ""}, "depth": None, "original": None}
    return json.dumps(plain).encode()


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b"{}", b"null", b'{"captured_at": 3, "camera": 4}', b"\xff\xfe"])
def test_a_label_that_can_not_be_read_is_listed_by_its_name(text: bytes) -> None:
    item = item_of("20260830T120431.120Z-cam-1-77", text)
    assert (item.camera, item.frame, item.captured_at) == ("cam-1", 77, "2026-08-30T12:04:31.120Z")
    assert (item.files, item.complete, item.objects) == ({}, False, ())


@pytest.mark.parametrize(
    "change",
    [
        {"frame": 10**30},
        {"captured_at": "\ud800"},
        {"captured_at": "x" * 2_000_000},
        {"recording": "\udfff"},
        {"files": {"rgb": {"path": "\ud800"}}},
    ],
)
def test_a_label_that_no_answer_can_hold_is_listed_by_its_name(tmp_path: Path, change: dict[str, Any]) -> None:
    sample = labels()[0].sample
    path = tmp_path / label_path(sample)
    path.parent.mkdir()
    path.write_text(json.dumps(json.loads(stored(labels()[0])) | change))
    index = SampleIndex(tmp_path)
    index.build()
    page = index.page(SampleFilter(), 0, 9)
    assert decode(Answer, encode(Answer(key="k", listed=page))).listed == page
    (item,) = page.samples
    assert (item.name, item.files, item.complete) == (sample, {}, False)


def test_a_page_fits_into_an_answer_however_much_is_in_the_samples(tmp_path: Path) -> None:
    index = SampleIndex(tmp_path)
    many = tuple(object_label(number).model_copy(update={"name": "x" * 60}) for number in range(16))
    for number in range(300):
        label = label_for(number).model_copy(update={"objects": many})
        index.add(item_of(label.sample, stored(label)))
    offset, seen, pages = 0, 0, 0
    while True:
        page = index.page(SampleFilter(), offset, 500)
        assert decode(Answer, encode(Answer(key="k", listed=page))).listed == page
        seen, pages = seen + len(page.samples), pages + 1
        if page.next_offset is None:
            break
        offset = page.next_offset
    assert (seen, pages > 1) == (300, True)


def test_what_is_read_leniently_is_what_the_model_wants() -> None:
    item = item_of(labels()[1].sample, stored(labels()[1]))
    assert SampleItem.model_validate(item.model_dump(), strict=True) == item
