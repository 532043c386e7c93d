"""Locks: exclusive, naming their holder, gone with it, and safe against removal races."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from common.bus import NameLock, holder_of
from common.errors import ConfigError, NameTakenError


def test_a_second_holder_is_refused_and_told_the_first(tmp_path: Path) -> None:
    path = tmp_path / "store.lock"
    with NameLock(path, "store"):
        with pytest.raises(NameTakenError, match=r"store is held by store \(pid \d+\)"):
            NameLock(path, "other")
        assert holder_of(path) is not None
    assert not path.exists()
    assert holder_of(path) is None


def test_a_dead_holders_file_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    path.write_text("a longer text of a dead process (pid 1)")
    with NameLock(path, "b"):
        assert path.read_text().startswith("b (pid")


def test_release_is_idempotent_and_removes_no_successors_file(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    first = NameLock(path, "first")
    first.release()
    with NameLock(path, "second"):
        first.release()
        assert path.exists()


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("keep")
    (tmp_path / "a.lock").symlink_to(target)
    with pytest.raises(ConfigError, match=r"a\.lock"):
        NameLock(tmp_path / "a.lock", "x")
    assert target.read_text() == "keep"


def test_only_one_holds_it_at_a_time_though_each_removes_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    inside = 0
    most = 0
    taken = 0
    guard = threading.Lock()

    def contend() -> None:
        nonlocal inside, most, taken
        mine = 0
        while mine < 25:
            try:
                lock = NameLock(path, "one of many")
            except NameTakenError:
                continue
            with guard:
                inside += 1
                most = max(most, inside)
            with guard:
                inside -= 1
                taken += 1
            mine += 1
            lock.release()

    threads = [threading.Thread(target=contend) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert (most, taken) == (1, 150)
    assert not path.exists()
