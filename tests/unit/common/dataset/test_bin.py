"""Moving samples between a session and its bin: whole, durable, idempotent, and sound wherever a kill cuts it off."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Collection
from pathlib import Path

import pytest

from common.dataset import SessionReader, label_path, picture_path
from common.dataset import bin as bin_module
from common.dataset.bin import bin_of, delete, restore, settle
from common.dataset.emptied import REMOVED_FILE, empty, finish_removal, removed
from common.errors import RefusedError
from tests.support.sessions import frames, make_session, places

Move = Callable[[Path, Collection[str]], tuple[str, ...]]


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Three samples, of frames 1 to 3."""
    make_session(tmp_path / "monday", *frames(1, 2, 3))
    return tmp_path / "monday"


def names(session: Path) -> tuple[str, ...]:
    return SessionReader(session).samples()


def test_a_deleted_sample_is_in_the_bin_and_nowhere_else(session: Path) -> None:
    one, two, three = names(session)
    assert delete(session, [two]) == (two,)
    assert places(session) == {one: "session", two: "bin", three: "session"}
    reader = SessionReader(session)
    assert reader.samples() == (one, three)
    assert reader.bin is not None
    assert reader.bin.samples() == (two,)
    reader.bin.verify(two)
    assert reader.bin.original(two) is not None


def test_restored_samples_are_as_they_were(session: Path) -> None:
    before = {path: path.read_bytes() for path in session.rglob("*") if path.is_file()}
    moved = names(session)
    delete(session, moved)
    assert restore(session, moved) == moved
    assert {path: path.read_bytes() for path in session.rglob("*") if path.is_file()} == before


def test_what_is_there_already_is_no_mistake_and_counts_once(session: Path) -> None:
    one, two, _ = names(session)
    assert delete(session, [one, one]) == (one,)
    assert delete(session, [one, two]) == (two,)
    assert delete(session, [one]) == ()
    assert restore(session, [one]) == (one,)
    assert restore(session, [one]) == ()


@pytest.mark.parametrize("move", [delete, restore])
def test_one_unknown_name_and_nothing_is_moved(session: Path, move: Move) -> None:
    one, two, three = names(session)
    delete(session, [three])
    before = places(session)
    with pytest.raises(RefusedError, match=r"monday has no sample 20260101T000000.000Z-cam0-9; nothing") as refused:
        move(session, [one, three, "20260101T000000.000Z-cam0-9"])
    assert refused.value.code == "no_sample"
    assert places(session) == before
    assert two in before


def test_a_sample_with_a_damaged_label_can_be_deleted_with_its_pictures(session: Path) -> None:
    one, *_ = names(session)
    (session / label_path(one)).write_text("{")
    assert delete(session, [one]) == (one,)
    assert (bin_of(session) / picture_path("rgb", one)).exists()
    assert not (session / picture_path("rgb", one)).exists()


def test_a_session_without_a_bin_needs_no_settling(session: Path) -> None:
    assert settle(session).samples == set()
    assert not bin_of(session).exists()


def in_a_child(do: Callable[[], object], cut_off_at: int) -> bool:
    """Do it in a child that is killed just before its file operation number ``cut_off_at``; whether it was."""
    child = os.fork()
    if child == 0:
        left = cut_off_at

        def counted(call: Callable[..., object]) -> Callable[..., object]:
            def wrapped(*arguments: object) -> object:
                nonlocal left
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                left -= 1
                return call(*arguments)

            return wrapped

        Path.rename = counted(Path.rename)  # type: ignore[method-assign, assignment]
        Path.unlink = counted(Path.unlink)  # type: ignore[method-assign, assignment]
        bin_module.sync_folder = counted(bin_module.sync_folder)  # type: ignore[assignment]
        try:
            do()
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


@pytest.mark.parametrize("move", [delete, restore])
def test_wherever_a_kill_cuts_a_move_off_each_sample_is_whole_in_one_place(tmp_path: Path, move: Move) -> None:
    whole = tmp_path / "whole"
    moving = make_session(whole, *frames(1, 2, 3))[:2]
    if move is restore:
        delete(whole, moving)
    step, ends = 0, set()
    while True:
        session = shutil.copytree(whole, tmp_path / f"cut-{step}")
        killed = in_a_child(lambda: move(session, moving), step)  # noqa: B023 - done within the round
        found = settle(session)
        after = places(session)
        assert len(after) == 3
        assert {name for name, place in after.items() if place == "bin"} == found.samples
        ends.add(frozenset(after.items()))
        assert settle(session).moved == [], "nothing is left to be settled"
        move(session, moving)  # as a repeated order does
        assert {places(session)[name] for name in moving} == {"bin" if move is delete else "session"}
        if not killed:
            break
        step += 1
    assert step > 10, "the kills met renames and fsyncs"
    assert len(ends) == 3, "neither, the first one, both"


def test_a_move_that_fails_is_taken_back(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rename = Path.rename
    before = places(session)
    for failing in range(1, 9):
        left = failing

        def fails_once(path: Path, target: Path) -> Path:
            nonlocal left
            left -= 1
            if left == 0:
                raise OSError(28, "No space left on device")
            return rename(path, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", fails_once)
            with pytest.raises(OSError, match="No space"):
                delete(session, names(session))
        assert places(session) == before


def test_two_names_of_one_file_are_one_again(session: Path) -> None:
    """What a file system may show after a power cut in the middle of a rename."""
    one, *_ = names(session)
    delete(session, [one])
    for path in (label_path(one), picture_path("rgb", one)):
        (session / path).hardlink_to(bin_of(session) / path)
    assert settle(session).samples == set()
    assert places(session)[one] == "session"


def test_a_sample_that_somebody_copied_is_left_alone_and_named(session: Path) -> None:
    one, *_ = names(session)
    delete(session, [one])
    (session / label_path(one)).write_bytes((bin_of(session) / label_path(one)).read_bytes() + b"\n")
    found = settle(session)
    assert (found.twice, found.samples, found.moved) == ([one], set(), [])
    assert (bin_of(session) / picture_path("rgb", one)).exists()


# --- emptying ---------------------------------------------------------------------------------------------


def test_an_emptied_bin_remembers_names_and_recordings(session: Path) -> None:
    one, two, three = names(session)
    delete(session, [one, two])
    size = sum(path.stat().st_size for path in bin_of(session).rglob("*") if path.is_file())
    assert empty(session, {one: "rec-a", two: None}) == size
    assert places(session) == {three: "session"}
    assert removed(session) == {one: "rec-a", two: None}
    delete(session, [three])
    empty(session, {three: "rec-b"})
    assert removed(session) == {one: "rec-a", two: None, three: "rec-b"}
    with pytest.raises(RefusedError):
        restore(session, [one])


def test_wherever_a_kill_cuts_emptying_off_the_next_start_finishes_it(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    one, two, three = make_session(whole, *frames(1, 2, 3))
    delete(whole, [one, two])
    step = 0
    while True:
        session = shutil.copytree(whole, tmp_path / f"cut-{step}")
        killed = in_a_child(lambda: empty(session, {one: "rec-a"}), step)  # noqa: B023 - done within the round
        finish_removal(session, removed(session))
        settle(session)
        assert places(session) == {three: "session"}, "the names were on the disk before the first file went"
        if not killed:
            break
        step += 1
    assert step > 4


def test_a_torn_last_line_removes_nothing_and_the_next_ones_are_read(session: Path) -> None:
    one, two, _ = names(session)
    delete(session, [one])
    empty(session, {})
    with (bin_of(session) / REMOVED_FILE).open("ab") as file:
        file.write(b'{"sample": "2026')
    assert removed(session) == {one: None}
    delete(session, [two])
    empty(session, {})
    assert set(removed(session)) == {one, two}
