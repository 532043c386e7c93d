"""Sessions to export, made once a test run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.recorded import samples, write_session
from tools.cli import main

Export = Callable[..., dict[str, Any]]


@pytest.fixture(scope="session")
def session60(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """60 samples of two boxes with four sides, one every 2 s, with depth; some cut by the picture's edge."""
    folder = tmp_path_factory.mktemp("sessions") / "boxes"
    write_session(folder, samples(60))
    return folder


@pytest.fixture(scope="session")
def session12(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with 12 samples."""
    folder = tmp_path_factory.mktemp("sessions") / "few"
    write_session(folder, samples(12))
    return folder


@pytest.fixture
def export(capsys: pytest.CaptureFixture[str]) -> Export:
    """``export(format, session..., out=..., code=0, ...words)``: the JSON that the command prints."""

    def do(*words: str | Path, out: Path, code: int = 0) -> dict[str, Any]:
        capsys.readouterr()
        assert main(["export", *map(str, words), "--out", str(out), "--json"]) == code
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found

    return do


def tree(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Each file with its inode, size and time of change: equal if nothing was touched."""
    return {
        str(path.relative_to(folder)): (path.stat().st_ino, path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }
