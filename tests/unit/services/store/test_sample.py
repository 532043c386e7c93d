import gc
import json
import math
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest

from common.dataset import FOLDERS, SessionReader, label_schema
from common.errors import RefusedError
from common.frames import Pictures
from services.store import sample as sample_module
from services.store.png import encode_png
from services.store.sample import discard, is_stored, pictures_for, write_sample
from tests.support.samples import camera_label, label_for, pixels


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
    return tmp_path


def files_of(session: Path) -> set[str]:
    return {str(path.relative_to(session)) for path in session.rglob("*") if path.is_file()}


def test_a_sample_is_stored_whole_and_its_label_fits_the_schema(session: Path) -> None:
    label = label_for(7)
    colour, depth = pixels(7)
    assert not is_stored(session, label.sample)
    written = write_sample(session, label, {"rgb": colour, "depth": depth}, reserve=0)
    assert is_stored(session, label.sample)
    assert files_of(session) == {
        f"{kind}/{kind}_{label.sample}.{end}" for kind, end in (("rgb", "png"), ("depth", "png"), ("label", "json"))
    }
    assert written == sum((session / name).stat().st_size for name in files_of(session))
    text = (session / f"label/label_{label.sample}.json").read_text()
    jsonschema.validate(json.loads(text), label_schema())
    assert text.startswith('{\n "schema": "tagmill.label/1",\n "sample": ')
    SessionReader(session).verify(label.sample)


def test_the_label_comes_last(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    write = sample_module.write_bytes

    def spy(path: Path, data: bytes) -> None:
        write(path, data)
        order.append(path.parent.name)

    monkeypatch.setattr(sample_module, "write_bytes", spy)
    colour, depth = pixels(1)
    write_sample(session, label_for(1), {"rgb": colour, "depth": depth, "original": colour}, reserve=0)
    assert order == ["rgb", "depth", "original", "label"]


@pytest.mark.parametrize("missing", ["rgb", "depth", "label"])
def test_a_failure_at_any_file_leaves_nothing(session: Path, missing: str) -> None:
    (session / missing).rmdir()
    colour, depth = pixels(1)
    with pytest.raises(FileNotFoundError):
        write_sample(session, label_for(1), {"rgb": colour, "depth": depth, "original": colour}, reserve=0)
    assert files_of(session) == set()


def test_discard_removes_everything_of_one_sample_only(session: Path) -> None:
    colour, depth = pixels(1)
    for frame in (1, 2):
        write_sample(session, label_for(frame), {"rgb": colour, "depth": depth}, reserve=0)
    discard(session, label_for(1).sample)
    assert {name.rpartition("-")[2].split(".")[0] for name in files_of(session)} == {"2"}


def test_refused_before_the_disk_is_full(session: Path) -> None:
    with pytest.raises(RefusedError, match="is full") as caught:
        write_sample(session, label_for(1), {"rgb": pixels(1)[0]}, reserve=1 << 60)
    assert caught.value.code == "disk_full"
    assert files_of(session) == set()


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_number_that_json_has_not_is_refused(session: Path, number: float) -> None:
    whole = label_for(1)
    wrong = whole.model_copy(update={"objects": (whole.objects[0].model_copy(update={"distance_mm": number}),)})
    with pytest.raises(RefusedError, match=r"no finite number at objects\.0\.distance_mm") as caught:
        write_sample(session, wrong, {"rgb": pixels(1)[0]}, reserve=0)
    assert caught.value.code == "bad_sample"
    assert files_of(session) == set()


def test_which_pictures_a_sample_has() -> None:
    colour, depth = pixels(1)
    assert list(pictures_for(label_for(1), Pictures(colour, depth, None))) == ["rgb", "depth"]
    assert list(pictures_for(label_for(1, depth=False), Pictures(colour, depth, colour))) == ["rgb", "original"]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: (label_for(1), Pictures(pixels(1)[0], None, None)), "promises a depth picture"),
        (
            lambda: (label_for(1, camera_label(width=65)), Pictures(*pixels(1), None)),
            "64x48 pixels, its label says 65x48",
        ),
    ],
)
def test_pixels_that_contradict_the_label_are_refused(make: Callable[[], tuple], said: str) -> None:
    with pytest.raises(RefusedError, match=said) as caught:
        pictures_for(*make())
    assert caught.value.code == "bad_sample"


@pytest.mark.parametrize("picture", pixels(3))
def test_png_is_lossless(picture: np.ndarray) -> None:
    read = cv2.imdecode(np.frombuffer(encode_png(picture), np.uint8), cv2.IMREAD_UNCHANGED)
    assert read.dtype == picture.dtype
    assert np.array_equal(read, picture)


@pytest.mark.parametrize("picture", [np.zeros((4, 4, 3), np.float32), np.zeros((0, 4), np.uint8)])
def test_what_png_can_not_hold_is_an_error(picture: np.ndarray) -> None:
    with pytest.raises(ValueError, match="can't be stored as PNG"):
        encode_png(picture)


def test_nothing_of_a_label_stays_in_memory() -> None:
    def kept_after(frames: range) -> int:
        for frame in frames:
            sample_module._readable_text(label_for(frame))
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        at_first = kept_after(range(50))  # what is made once, too
        kept = kept_after(range(50, 1250)) - at_first
    finally:
        tracemalloc.stop()
    assert kept < 1200 * 40, "some of pydantic's cache of strings was 150 bytes a label"
