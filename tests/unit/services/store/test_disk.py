import errno
import os
from pathlib import Path

import pytest

from common.dataset.faults import explain
from common.dataset.locks import FolderLock
from common.errors import RefusedError
from services.store.disk import free_bytes, look, require_room
from tests.support.mounts import make_read_only, small_disk


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.ENOSPC, "disk_full"),
        (errno.EDQUOT, "disk_full"),
        (errno.EFBIG, "disk_full"),
        (errno.EROFS, "read_only"),
        (errno.EACCES, "read_only"),
        (errno.ENOENT, "no_dataset"),
        (errno.ENOTDIR, "no_dataset"),
        (errno.EIO, "disk_error"),
    ],
)
def test_an_error_becomes_a_code_and_one_sentence(number: int, code: str) -> None:
    info = explain(OSError(number, os.strerror(number)), Path("/data/boxes"))
    assert info.code == code
    assert "/data/boxes" in info.message
    assert os.strerror(number) in info.message
    assert "\n" not in info.message


def test_the_reserve_is_not_touched(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 1) as disk:
        assert free_bytes(disk) == 1 << 20
        require_room(disk, 500_000, reserve=500_000)
        with pytest.raises(RefusedError, match="are kept for the ledger") as caught:
            require_room(disk, 600_000, reserve=500_000)
        assert caught.value.code == "disk_full"


def test_a_look_tells_what_is_wrong(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 1) as disk:
        (disk / "rgb").mkdir()
        assert look(disk, ("rgb",), reserve=0).problem is None
        assert look(disk, ("rgb",), reserve=1 << 30).problem.code == "disk_full"
        assert look(disk, ("rgb", "label"), reserve=0).problem.code == "no_dataset"
        make_read_only(disk)
        assert look(disk, ("rgb",), reserve=0).problem.code == "read_only"
    gone = look(disk / "rgb", (), reserve=0)
    assert gone.problem.code == "no_dataset"
    assert gone.free_bytes is None


def test_one_writer_or_many_readers_of_a_lock(tmp_path: Path) -> None:
    with FolderLock(tmp_path), pytest.raises(RefusedError, match="another tagmill") as caught:
        FolderLock(tmp_path, shared=True)
    assert caught.value.code == "session_busy"
    with FolderLock(tmp_path, shared=True), FolderLock(tmp_path, shared=True), pytest.raises(RefusedError):
        FolderLock(tmp_path)
    lock = FolderLock(tmp_path)
    lock.release()
    lock.release()
    with pytest.raises(FileNotFoundError):
        FolderLock(tmp_path / "gone")
