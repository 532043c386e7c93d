"""Files that are whole or absent, also after a power cut: temporary file, fsync, rename, fsync of the folder."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

_TEMPORARY_PREFIX = "."
_TEMPORARY_SUFFIX = ".tmp"


def temporary_path(path: Path) -> Path:
    """The temporary file of ``path``, in the same folder.

    It has a fixed name, so that a second attempt takes over what a killed first one left. Only one writer
    at a time may therefore write ``path``.
    """
    return path.with_name(f"{_TEMPORARY_PREFIX}{path.name}{_TEMPORARY_SUFFIX}")


def is_temporary(file_name: str) -> bool:
    """Whether a file of this name was left half-written by :func:`write_bytes`."""
    return file_name.startswith(_TEMPORARY_PREFIX) and file_name.endswith(_TEMPORARY_SUFFIX)


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` durably to ``path``, which is replaced at once or not at all.

    Returns when the data and the name are on the disk. Raises OSError (disk full, read-only, folder gone);
    the temporary file is removed then, and an older ``path`` is untouched.
    """
    temporary = temporary_path(path)
    try:
        _write_and_sync(temporary, data)
        temporary.replace(path)
    except BaseException:
        # What can't be removed on a broken disk is removed by the next start's recovery; the first error counts.
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    sync_folder(path.parent)


def write_json(path: Path, plain: Any, indent: int | None = 1) -> None:
    """Write a JSON-able value durably; raises ValueError for NaN and infinity, OSError as :func:`write_bytes`."""
    text = json.dumps(plain, indent=indent, ensure_ascii=False, allow_nan=False)
    write_bytes(path, text.encode() + b"\n")


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` (renames, removals) durable; raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents durable; one that exists costs nothing. Raises OSError."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def _write_and_sync(path: Path, data: bytes | memoryview) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
    try:
        _write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def append_bytes(path: Path, data: bytes) -> int:
    """Add whole lines to a file durably, which is made if it isn't there; returns where they begin.

    A last line without its end, which a kill cut off, gets one first. Raises OSError; nothing is added then.
    """
    created = not path.exists()
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        end = os.fstat(descriptor).st_size
        torn = end > 0 and os.pread(descriptor, 1, end - 1) != b"\n"
        try:
            _write_all(descriptor, b"\n" + data if torn else data)
            os.fsync(descriptor)
        except OSError:
            os.ftruncate(descriptor, end)
            raise
    finally:
        os.close(descriptor)
    if created:
        sync_folder(path.parent)
    return end + torn


def _write_all(descriptor: int, data: bytes | memoryview) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]
