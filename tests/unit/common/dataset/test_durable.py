import errno
import json
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from common.dataset import append_bytes, is_temporary, write_bytes, write_json
from common.dataset.durable import temporary_path
from tests.support.mounts import make_read_only, small_disk


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file of this process may grow beyond ``size``: the next write fails in the middle."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_writes_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, b"one")
    write_bytes(path, memoryview(b"two!"))
    assert path.read_bytes() == b"two!"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]


def test_data_is_synced_before_the_name_and_the_name_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    fsync, replace = os.fsync, os.replace

    def spy_fsync(descriptor: int) -> None:
        seen.append(f"fsync {Path(f'/proc/self/fd/{descriptor}').readlink().name}")
        fsync(descriptor)

    def spy_replace(source: Path, target: Path) -> None:
        seen.append(f"rename {Path(source).name} {Path(target).name}")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", spy_fsync)
    monkeypatch.setattr(os, "replace", spy_replace)
    write_bytes(tmp_path / "a.bin", b"data")
    assert seen == ["fsync .a.bin.tmp", "rename .a.bin.tmp a.bin", f"fsync {tmp_path.name}"]


def test_a_write_that_fails_in_the_middle_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, b"old")
    with file_size_limit(4096), pytest.raises(OSError) as caught:
        write_bytes(path, bytes(100_000))
    assert caught.value.errno == errno.EFBIG
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]


def test_a_full_disk_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 0.25) as disk:
        write_bytes(disk / "a.bin", b"old")
        with pytest.raises(OSError) as caught:
            write_bytes(disk / "a.bin", bytes(1_000_000))
        assert caught.value.errno == errno.ENOSPC
        assert (disk / "a.bin").read_bytes() == b"old"
        assert [entry.name for entry in disk.iterdir()] == ["a.bin"]
        write_bytes(disk / "a.bin", b"new")
        assert (disk / "a.bin").read_bytes() == b"new"


def test_a_read_only_disk_is_an_error(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 0.25) as disk:
        make_read_only(disk)
        with pytest.raises(OSError) as caught:
            write_bytes(disk / "a.bin", b"data")
        assert caught.value.errno == errno.EROFS
        assert list(disk.iterdir()) == []


def test_a_killed_writers_rest_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    temporary_path(path).write_bytes(b"half of something longer than the data")
    assert is_temporary(temporary_path(path).name)
    write_bytes(path, b"data")
    assert path.read_bytes() == b"data"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.bin"]


def test_json_has_no_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"grüße": [1.5, None]})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"grüße": [1.5, None]}
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "b.json", {"x": float("nan")})
    assert not (tmp_path / "b.json").exists()


@pytest.mark.parametrize("name", ["a.bin", ".hidden", "x.tmp", "label_20260830T120431.120Z-cam0-1.json"])
def test_other_files_are_not_taken_for_temporary_ones(name: str) -> None:
    assert not is_temporary(name)


def test_lines_are_added_whole_and_after_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    assert append_bytes(path, b"one\n") == 0
    assert append_bytes(path, b"two\nthree\n") == 4
    with path.open("ab") as file:
        file.write(b"cut of")
    assert append_bytes(path, b"four\n") == path.read_bytes().index(b"four")
    assert path.read_bytes().splitlines() == [b"one", b"two", b"three", b"cut of", b"four"]


def test_what_can_not_be_added_whole_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    append_bytes(path, b"one\n")
    with file_size_limit(100), pytest.raises(OSError, match="too large"):
        append_bytes(path, b"x" * 200 + b"\n")
    assert path.read_bytes() == b"one\n"
