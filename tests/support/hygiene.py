"""Each test has a prefix and a run folder of its own, and leaves nothing behind."""

from __future__ import annotations

import os
import secrets
import shutil
import stat
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
import zmq

SETTLE_S = 3.0
_NOT_OURS = ("resource_tracker", "forkserver")
"""Helpers of multiprocessing that live as long as the interpreter."""


@dataclass(frozen=True)
class Place:
    """Where the test's stack lives."""

    prefix: str
    run_root: Path

    @property
    def run_dir(self) -> Path:
        return self.run_root / self.prefix


@contextmanager
def own_place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    """Set TAGMILL_PREFIX and TAGMILL_RUN_DIR; on leaving, fail for whatever was left behind."""
    token = secrets.token_hex(4)
    # Not tmp_path: a Unix socket's path has 107 bytes at most.
    place = Place(f"t{token}", Path(f"/tmp/tm-{token}"))
    monkeypatch.setenv("TAGMILL_PREFIX", place.prefix)
    monkeypatch.setenv("TAGMILL_RUN_DIR", str(place.run_root))
    threads, children = set(threading.enumerate()), _children()
    try:
        yield place
        left = _settled(place, threads, children)
    finally:
        shutil.rmtree(place.run_root, ignore_errors=True)
    if left:
        pytest.fail("the test left behind: " + "; ".join(left), pytrace=False)


def _settled(place: Place, threads: set[threading.Thread], children: set[int]) -> list[str]:
    """What is left once everything that is about to end had ``SETTLE_S`` to do so."""
    deadline = time.monotonic() + SETTLE_S
    while (left := _leftovers(place, threads, children)) and time.monotonic() < deadline:
        time.sleep(0.02)
    return left


def _leftovers(place: Place, threads: set[threading.Thread], children: set[int]) -> list[str]:
    left = [f"thread {thread.name}" for thread in set(threading.enumerate()) - threads if thread.is_alive()]
    left += [f"process {pid} {_command(pid)}" for pid in _children() - children]
    left += [f"file {path}" for path in _run_files(place.run_root)]
    left += [f"shared memory {path}" for path in Path("/dev/shm").glob(f"tagmill-{place.prefix}-*")]
    left += [f"open socket {made}" for made in list(getattr(zmq.Context.instance(), "_sockets", ())) if not made.closed]
    return left


def _run_files(folder: Path) -> list[Path]:
    """Socket and lock files; logs and supervisor files in the run folder are none of our business."""
    found = []
    for path in folder.rglob("*"):
        try:
            mode = path.lstat().st_mode
        except FileNotFoundError:
            continue
        if stat.S_ISSOCK(mode) or path.suffix == ".lock":
            found.append(path)
    return found


def _children() -> set[int]:
    """All descendants of this process, but for multiprocessing's own helpers."""
    found: set[int] = set()
    unseen = [os.getpid()]
    while unseen:
        for listing in Path(f"/proc/{unseen.pop()}/task").glob("*/children"):
            try:
                pids = [int(word) for word in listing.read_text().split()]
            except (FileNotFoundError, ProcessLookupError):
                continue
            unseen += pids
            found.update(pids)
    return {pid for pid in found if not any(word in _command(pid) for word in _NOT_OURS)}


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")[:200]
    except (FileNotFoundError, ProcessLookupError):
        return "(gone)"


def processes_of(prefix: str) -> dict[int, str]:
    """Every process on this machine that runs in the stack ``prefix``, whoever its parent is."""
    found = {}
    for process in psutil.process_iter():
        try:
            if process.environ().get("TAGMILL_PREFIX") != prefix or process.pid == os.getpid():
                continue
            helper = process.ppid() == os.getpid() and any(word in _command(process.pid) for word in _NOT_OURS)
            if not helper:
                found[process.pid] = " ".join(process.cmdline())[:200]
        except (psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
            continue
    return found
