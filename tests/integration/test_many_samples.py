"""A session of 10,000 samples in the real store: listed, filtered and moved, with the times printed (`-s`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import psutil
import pytest

from common.dataset import label_path
from common.ids import sample_name
from common.labels import SampleFiles, StoredFile
from tests.support.samples import START_NS, StoreSide, label_for, object_label
from tests.support.sessions import make_session
from tests.support.stack import Stack, write_rig

pytestmark = [pytest.mark.process, pytest.mark.long]

MANY = 10_000
T = TypeVar("T")


@pytest.fixture
def label_side(stack: Stack) -> Iterator[StoreSide]:
    stack.endpoints.prepare()
    side = StoreSide(stack.endpoints)
    yield side
    side.close()


def timed(what: str, do: Callable[[], T]) -> T:
    began = time.monotonic()
    result = do()
    print(f"{what}: {(time.monotonic() - began) * 1000:.0f} ms")
    return result


def fill(session: Path) -> None:
    """Labels as large as real ones (two objects of eight corners, six sides), each with a small picture."""
    corners = tuple(object_label().corners) * 4
    objects = tuple(
        object_label(number).model_copy(update={"corners": corners, "sides": object_label(number).sides * 3})
        for number in range(2)
    )
    for frame in range(MANY):
        label = label_for(frame, wall_ns=START_NS + frame * 33_000_000)
        picture = StoredFile(path=f"rgb/rgb_{label.sample}.png", size=1, sha256="0" * 64)
        label = label.model_copy(update={"objects": objects, "files": SampleFiles(rgb=picture)})
        (session / picture.path).write_bytes(b"x")
        (session / label_path(label.sample)).write_text(label.model_dump_json(by_alias=True, indent=1) + "\n")


def test_ten_thousand_samples(stack: Stack, label_side: StoreSide) -> None:
    session = stack.folder / "dataset" / "test"
    store = stack.start_service("store", write_rig(stack.folder))
    assert label_side.session("empty").text == "empty"
    bare = psutil.Process(store.pid).memory_info().rss
    rig = (session / "session.json").read_bytes()
    make_session(session)
    (session / "session.json").write_bytes(rig)
    fill(session)
    size = (session / label_path(sample_name(START_NS, "cam0", 0))).stat().st_size
    timed(f"open a session of {MANY} samples ({size} bytes a label)", lambda: label_side.session("test"))
    assert timed("first list, once all labels are read", label_side.listed).total == MANY
    print(f"memory: {(psutil.Process(store.pid).memory_info().rss - bare) / 1e6:.0f} MB more")
    page = timed("a page of 100", lambda: label_side.listed(offset=5000))
    assert len(page.samples) == 100
    assert len(timed("a page of 500", lambda: label_side.listed(limit=500)).samples) == 500
    found = timed("a filter that fits all", lambda: label_side.listed(object="box-1", side="front", min_distance_mm=1))
    assert found.total == MANY
    assert timed("a filter that fits none", lambda: label_side.listed(object="box-7")).total == 0
    names = tuple(item.name for item in label_side.listed(limit=500).samples)
    assert timed("delete 1", lambda: label_side.answer_to(label_side.move("bin", names[0]))).error is None
    assert timed("delete 500", lambda: label_side.answer_to(label_side.move("bin", *names))).samples == names
    assert timed("a list after it", label_side.listed).in_bin == 500
    assert timed("restore 500", lambda: label_side.answer_to(label_side.move("session", *names))).samples == names
    assert label_side.listed().stored == MANY
    label_side.session("empty")
    assert timed("another session of 10,000", lambda: label_side.listed(session="test")).total == MANY
    assert timed("the same again", lambda: label_side.listed(session="test")).total == MANY
