"""Small and read-only disks for tests: a tmpfs of its own, where this user may mount one."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest


@contextmanager
def small_disk(folder: Path, megabytes: float) -> Iterator[Path]:
    """An empty disk of this size mounted on ``folder``; skips the test where that isn't allowed."""
    folder.mkdir(parents=True, exist_ok=True)
    made = _run("mount", "-t", "tmpfs", "-o", f"size={int(megabytes * 1024)}k", "tmpfs", str(folder))
    if made.returncode:
        pytest.skip(f"a tmpfs can't be mounted here: {made.stderr.strip()}")
    try:
        yield folder
    finally:
        assert _run("umount", "--lazy", str(folder)).returncode == 0


def make_read_only(folder: Path, *, read_only: bool = True) -> None:
    """Remount a small disk read-only (also for root), or writable again."""
    done = _run("mount", "-o", f"remount,{'ro' if read_only else 'rw'}", str(folder))
    assert done.returncode == 0, done.stderr


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except FileNotFoundError:
        return subprocess.CompletedProcess(command, 1, "", f"there is no {command[0]}")
