import shutil
from itertools import product
from pathlib import Path

import pytest

from common.dataset import FOLDERS, SESSION_FILE, label_path, picture_path
from common.dataset.durable import temporary_path
from services.store.recovery import MOST_HALF_WRITTEN, recover
from services.store.sample import write_sample
from tests.support.samples import camera_label, label_for, pixels

KINDS = ("rgb", "depth", "original")


def store(session: Path, frame: int, recording: str | None = "rec-a", camera: str = "cam0") -> str:
    label = label_for(frame, camera_label(camera), recording=recording)
    colour, depth = pixels(frame)
    write_sample(session, label, {"rgb": colour, "depth": depth, "original": colour}, reserve=0)
    return label.sample


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session with one whole sample (of frame 1)."""
    folder = tmp_path / "session"
    for name in FOLDERS:
        (folder / name).mkdir(parents=True)
    (folder / SESSION_FILE).write_text("{}")
    store(folder, 1)
    return folder


def files_of(session: Path) -> set[str]:
    return {str(path.relative_to(session)) for path in session.rglob("*") if path.is_file()}


def paths_of(session: Path, sample: str) -> list[Path]:
    """A sample's files in the order in which they are written."""
    return [*(session / picture_path(kind, sample) for kind in KINDS), session / label_path(sample)]


def half_written(session: Path, frame: int, done: int, torn: float | None) -> None:
    """What a kill leaves: ``done`` files whole, of the next one the share ``torn`` in its temporary file."""
    sample = store(session, frame)
    for position, path in enumerate(paths_of(session, sample)):
        if position == done and torn is not None:
            data = path.read_bytes()
            temporary_path(path).write_bytes(data[: int(len(data) * torn)])
        if position >= done:
            path.unlink()


@pytest.mark.parametrize(("done", "torn"), [*product(range(4), (None, 0.0, 0.5, 1.0))])
def test_every_half_written_state_is_removed(session: Path, done: int, torn: float | None) -> None:
    before = files_of(session)
    half_written(session, 2, done, torn)
    left = len(files_of(session) - before)
    found = recover(session)
    assert files_of(session) == before
    assert len(found.removed) == left
    assert found.samples == {label_for(1).sample}
    assert found.recorded == {"rec-a": {"cam0": 1}}
    assert recover(session).removed == []


def test_two_workers_leave_two_halves_and_a_torn_session_file(session: Path) -> None:
    before = files_of(session)
    half_written(session, 2, 1, 0.5)
    half_written(session, 3, 3, 0.9)
    temporary_path(session / SESSION_FILE).write_bytes(b'{"schema"')
    recover(session)
    assert files_of(session) == before


def test_a_complete_but_unanswered_sample_stays(session: Path) -> None:
    sample = store(session, 2)
    found = recover(session)
    assert sample in found.samples
    assert found.removed == []
    assert found.recorded == {"rec-a": {"cam0": 2}}


def test_pictures_of_another_format_are_recognised(session: Path) -> None:
    (session / picture_path("rgb", label_for(9).sample, "jpg")).write_bytes(b"x")
    assert recover(session).removed == [f"rgb/rgb_{label_for(9).sample}.jpg"]


def test_what_is_not_ours_stays(session: Path) -> None:
    foreign = [
        "rgb/notes.txt",
        "rgb/rgb_mine.png",
        "label/classes.json",
        "label/.hidden",
        "README.md",
        "depth/Thumbs.db",
    ]
    for name in foreign:
        (session / name).write_text("mine")
    (session / "masks").mkdir()
    (session / "masks" / "rgb_x.png").write_text("mine")
    assert recover(session).removed == []
    assert set(foreign) <= files_of(session)


def test_more_orphans_than_a_crash_can_leave_are_not_touched(session: Path) -> None:
    for frame in range(2, 3 + MOST_HALF_WRITTEN):
        store(session, frame)
    shutil.rmtree(session / "label")
    before = files_of(session)
    found = recover(session)
    assert found.orphans == MOST_HALF_WRITTEN + 2
    assert found.removed == []
    assert files_of(session) == before


def test_counts_by_recording_and_camera(session: Path) -> None:
    store(session, 2, "rec-b", "cam-1")
    store(session, 3, "rec-b", "cam0")
    store(session, 4, "rec-b", "cam-1")
    store(session, 5, None)
    found = recover(session)
    assert found.recorded == {"rec-a": {"cam0": 1}, "rec-b": {"cam-1": 2, "cam0": 1}}
    assert len(found.samples) == 5


def test_a_label_that_another_tool_wrote_again_is_counted_too(session: Path) -> None:
    path = session / label_path(store(session, 2, "rec-b"))
    lines = path.read_text().replace("\n", " ")
    path.write_text(lines)
    assert recover(session).recorded == {"rec-a": {"cam0": 1}, "rec-b": {"cam0": 1}}


def test_damage_is_told_and_left_alone(session: Path) -> None:
    unreadable, without_picture = store(session, 2), store(session, 3)
    (session / label_path(unreadable)).write_text("")
    (session / picture_path("rgb", without_picture)).unlink()
    before = files_of(session)
    found = recover(session)
    assert found.damaged == sorted([unreadable, without_picture])
    assert found.samples >= {unreadable, without_picture}
    assert files_of(session) == before


def test_one_spoilt_byte_in_a_recordings_name_is_damage_as_any_other(session: Path) -> None:
    spoilt = store(session, 2, "rec-b")
    path = session / label_path(spoilt)
    path.write_bytes(path.read_bytes().replace(b"rec-b", b"rec-\xe2"))
    found = recover(session)
    assert (found.damaged, found.recorded) == ([spoilt], {"rec-a": {"cam0": 1}})


def test_an_empty_session_needs_nothing(tmp_path: Path) -> None:
    found = recover(tmp_path)
    assert (found.samples, found.removed, found.recorded) == (set(), [], {})
