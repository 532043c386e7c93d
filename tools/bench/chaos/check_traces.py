"""The judge's look around after the stack has ended: no segment, socket, lock or process may be left."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def check_traces(shm: Path, prefix: str | None, run_dir: Path | None) -> list[str]:
    """A sentence for each thing left; ``prefix`` and ``run_dir`` None: nobody knows the stack's any more."""
    left = [f"shared memory is left: {path.name}" for path in sorted(shm.glob("*"))] if shm.is_dir() else []
    if run_dir is not None:
        left += [f"{path.name} is left in the run folder" for path in sorted(run_dir.rglob("*")) if _is_trace(path)]
    if prefix is not None:
        left += [f"a process is left: {words}" for words in _processes(prefix)]
    return left


def _is_trace(path: Path) -> bool:
    return stat.S_ISSOCK(path.lstat().st_mode) or path.suffix in {".lock", ".pid", ".life"}


def _processes(prefix: str) -> list[str]:
    """The command lines of processes whose environment names this stack."""
    mark = f"TAGMILL_PREFIX={prefix}".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        if int(folder.name) == os.getpid():
            continue
        try:
            ours = mark in (folder / "environ").read_bytes().split(b"\0")
            words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace").strip()
        except OSError:  # it has ended, or is somebody else's
            continue
        if ours and words:
            found.append(f"{folder.name} {words[:160]}")
    return found
