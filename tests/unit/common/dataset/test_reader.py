from pathlib import Path

import cv2
import numpy as np
import pytest

from common.dataset import FOLDERS, SessionReader, label_path
from common.dataset.layout import PICTURES
from common.errors import DatasetError
from common.labels import Label
from services.store.sample import write_sample
from tests.support.samples import label_for, pixels


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for folder in FOLDERS:
        (tmp_path / folder).mkdir()
    return tmp_path


def stored(session: Path, frame: int = 1, *, depth: bool = True, original: bool = False) -> Label:
    label = label_for(frame, depth=depth)
    colour, distances = pixels(frame)
    pictures = {
        "rgb": colour,
        **({"depth": distances} if depth else {}),
        **({"original": 255 - colour} if original else {}),
    }
    write_sample(session, label, pictures, reserve=0)
    return label


def test_reads_what_was_stored(session: Path) -> None:
    labels = [stored(session, frame, original=True) for frame in (3, 1, 2)]
    reader = SessionReader(session)
    assert reader.samples() == tuple(sorted(label.sample for label in labels))
    for label in labels:
        colour, depth = pixels(label.frame)
        read = reader.label(label.sample)
        assert read.model_copy(update={"files": None}) == label
        assert np.array_equal(reader.colour(label.sample), colour)
        assert np.array_equal(reader.depth(read), depth)
        assert np.array_equal(reader.original(read), 255 - colour)
        reader.verify(read)


def test_depth_and_original_may_be_missing(session: Path) -> None:
    label = stored(session, depth=False)
    reader = SessionReader(session)
    assert reader.depth(label.sample) is None
    assert reader.original(label.sample) is None
    reader.verify(label.sample)


def test_goes_by_the_label_not_by_a_built_path(session: Path) -> None:
    sample = stored(session).sample
    reader = SessionReader(session)
    label = reader.label(sample)
    assert label.files is not None
    (session / label.files.rgb.path).rename(session / "rgb/elsewhere.png")
    moved = label.files.model_copy(update={"rgb": label.files.rgb.model_copy(update={"path": "rgb/elsewhere.png"})})
    assert reader.colour(label.model_copy(update={"files": moved})).shape == (48, 64, 3)


def test_damage_is_found_and_named(session: Path) -> None:
    sample = stored(session).sample
    reader = SessionReader(session)
    path = session / f"rgb/rgb_{sample}.png"
    data = bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(data)
    with pytest.raises(DatasetError, match="checksum") as caught:
        reader.verify(sample)
    assert caught.value.code == "damaged"
    path.write_bytes(data[:-1])
    with pytest.raises(DatasetError, match="its label says"):
        reader.verify(sample)
    path.write_bytes(b"no picture")
    with pytest.raises(DatasetError, match="no picture"):
        reader.colour(sample)
    path.write_bytes(b"")
    with pytest.raises(DatasetError, match="empty"):
        reader.colour(sample)
    path.unlink()
    with pytest.raises(DatasetError, match="is missing"):
        reader.verify(sample)


def test_a_label_of_another_schema_is_said_clearly(session: Path) -> None:
    sample = stored(session).sample
    path = session / label_path(sample)
    path.write_text(path.read_text().replace("tagmill.label/1", "tagmill.label/9"))
    with pytest.raises(DatasetError, match=r"has schema 'tagmill.label/9', this tagmill reads 'tagmill.label/1'"):
        SessionReader(session).label(sample)


def test_wrong_names_folders_and_paths(session: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no such folder"):
        SessionReader(tmp_path / "nowhere")
    reader = SessionReader(session)
    with pytest.raises(DatasetError, match="is missing") as caught:
        reader.label("20260830T120431.120Z-cam0-1")
    assert caught.value.code == "missing_file"
    with pytest.raises(DatasetError, match="names no files"):
        reader.colour(label_for(1))
    label = reader.label(stored(session).sample)
    assert label.files is not None
    outside = label.files.rgb.model_copy(update={"path": "../../etc/passwd"})
    with pytest.raises(DatasetError, match="outside of the session"):
        reader.colour(label.model_copy(update={"files": label.files.model_copy(update={"rgb": outside})}))


def test_a_depth_picture_of_another_kind_is_refused(session: Path) -> None:
    sample = stored(session).sample
    cv2.imwrite(str(session / f"depth/depth_{sample}.png"), np.zeros((4, 4), np.uint8))
    with pytest.raises(DatasetError, match=r"not \(H, W\) uint16"):
        SessionReader(session).depth(sample)


def test_an_empty_session_has_no_samples(tmp_path: Path) -> None:
    assert SessionReader(tmp_path).samples() == ()
    assert set(PICTURES) < set(FOLDERS)
