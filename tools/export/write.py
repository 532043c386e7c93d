"""Putting an export on the disk: each file whole or absent, what is there already kept, the index last.

The index (``data.yaml``, ``instances_*.json`` ...) is what a trainer opens. It is taken away before anything changes
and written when all else is there, so half an export can't be trained on by mistake.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

from common.dataset.durable import is_temporary, temporary_path
from common.dataset.faults import explain
from common.dataset.locks import FolderLock
from common.errors import DatasetError, NoSpaceError, RefusedError
from tools.export.manifest import MANIFEST, Manifest
from tools.export.model import Export, Exporter, OutFile

RESERVE_BYTES = 50_000_000
"""Left free on the disk."""
Tick = Callable[[], None]
S = TypeVar("S")
T = TypeVar("T")


@dataclass
class Done:
    """What a run did: files ``written`` (of them ``linked``), ``kept``, ``removed``; bytes that were written."""

    written: int = 0
    linked: int = 0
    kept: int = 0
    removed: int = 0
    bytes: int = 0


@dataclass(frozen=True)
class Prepared:
    """All files of an export, and which of them must be written. ``need``: bytes that the disk must have."""

    folder: Path
    before: Manifest | None
    files: tuple[OutFile, ...]
    index: tuple[OutFile, ...]
    missing: tuple[OutFile, ...]
    index_missing: tuple[OutFile, ...]
    need: int
    copy: bool


def prepare(
    folder: Path, exporter: Exporter, export: Export, workers: int, *, copy: bool, tick: Tick = lambda: None
) -> Prepared:
    """Work out every file (``tick`` after each shot); nothing is written. Raises RefusedError, DatasetError."""
    before = Manifest.read(folder)
    written = _parallel(lambda shot: exporter.shot(shot, export), export.shots, workers, tick)
    files = [file for one in written for file in one.files]
    index = exporter.index(export, [one.told for one in written])
    _no_two(files + index)
    here = {} if before is None else before.files
    missing = [file for file in files if not _there(folder, file, here)]
    index_missing = [file for file in index if not _there(folder, file, here)]
    links = [] if copy else [file for file in missing if file.link is not None]
    if links and not _can_link(links[0], folder):
        copy = True
    need = sum(file.size for file in missing + index_missing if file.link is None)
    need += sum(file.link.stat().st_size for file in missing if file.link is not None) if copy else 0
    return Prepared(folder, before, tuple(files), tuple(index), tuple(missing), tuple(index_missing), need, copy)


def write(prepared: Prepared, export: Export, workers: int, tick: Tick = lambda: None) -> Done:
    """Write what is missing and take away what is the export's no more; ``tick`` after each file.

    Raises NoSpaceError before anything is written if the disk is too small, DatasetError for a picture that can't
    be read, RefusedError for a folder that can't be written. On these, and on Ctrl-C, every file is whole or absent.
    """
    folder = prepared.folder
    done = Done(kept=len(prepared.files) + len(prepared.index))
    manifest = _manifest(prepared, export)
    stale = _stale(prepared)
    if not (prepared.missing or prepared.index_missing or stale) and _same(prepared.before, manifest):
        return done
    _room(prepared)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FolderLock(folder):
            _change(prepared, manifest, stale, done, workers, tick)
    except OSError as error:
        told = explain(error, folder)
        message = told.message.replace(" or move the dataset (dataset.root)", ", or choose another folder")
        message = message.replace(", or open another session", "")
        raise RefusedError(f"{message}; the same command goes on where it stopped", code="bad_out") from error
    done.kept -= done.written
    return done


def _change(prepared: Prepared, manifest: Manifest, stale: Sequence[str], done: Done, workers: int, tick: Tick) -> None:
    folder = prepared.folder
    _clear_temporaries(folder, prepared)
    _begin(prepared, manifest, stale, done)
    for parent in sorted({folder / file.path.parent for file in (*prepared.files, *prepared.index)}):
        parent.mkdir(parents=True, exist_ok=True)
    _parallel(lambda file: _put(folder, file, done, prepared.copy), prepared.missing, workers, tick)
    for file in prepared.index:
        if not (folder / file.path).exists():
            _put(folder, file, done, prepared.copy)
    for file in (*prepared.files, *prepared.index):
        manifest.files[str(file.path)] = (file.key, (folder / file.path).stat().st_size)
    manifest.complete = True
    manifest.write(folder)


def _manifest(prepared: Prepared, export: Export) -> Manifest:
    samples = {
        shot.stem: {"session": shot.source.folder.name, "sample": shot.source.label.sample, "part": shot.split}
        for shot in export.shots
    }
    sizes: dict[str, tuple[str, int | None]] = {}
    here = {} if prepared.before is None else prepared.before.files
    for file in (*prepared.files, *prepared.index):
        key, size = here.get(str(file.path), ("", None))
        sizes[str(file.path)] = (file.key, size if key == file.key else None)
    return Manifest(False, export.stated, samples, sizes)


def _same(before: Manifest | None, now: Manifest) -> bool:
    return (
        before is not None
        and before.complete
        and (before.stated, before.samples, before.files) == (now.stated, now.samples, now.files)
    )


def _stale(prepared: Prepared) -> list[str]:
    """Paths that are the export's no more."""
    if prepared.before is None:
        return []
    wanted = {str(file.path) for file in (*prepared.files, *prepared.index)}
    return [path for path in prepared.before.files if path not in wanted and (prepared.folder / path).exists()]


def _begin(prepared: Prepared, manifest: Manifest, stale: Sequence[str], done: Done) -> None:
    """Take away the index and what is stale or made anew, then say in the manifest what is to come."""
    folder = prepared.folder
    changing = {str(file.path) for file in prepared.missing} | set(stale)
    for path in [*(str(file.path) for file in prepared.index), *sorted(changing)]:
        target = _inside(folder, path)
        if target.exists():
            target.unlink()
            done.removed += path in stale
    emptied = {parent for path in stale for parent in PurePosixPath(path).parents if parent.name}
    for parent in sorted((folder / one for one in emptied), reverse=True):
        if parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()
    manifest.write(folder)


def _inside(folder: Path, path: str) -> Path:
    if PurePosixPath(path).is_absolute() or ".." in PurePosixPath(path).parts:
        raise DatasetError(f"{folder / MANIFEST} names {path}, which is outside of the export; it is damaged")
    return folder / path


def _there(folder: Path, file: OutFile, known: dict[str, tuple[str, int | None]]) -> bool:
    """Whether the file is there with the content it should have."""
    key, size = known.get(str(file.path), ("", None))
    if key != file.key:
        return False
    try:
        found = (folder / file.path).stat().st_size
    except OSError:
        return False
    # Without a size the run that wrote it was cut off; a file is renamed into place whole, so it is whole.
    return found == size if size is not None else found > 0 or file.size == 0


def _put(folder: Path, file: OutFile, done: Done, copy: bool) -> None:
    path = folder / file.path
    linked = file.link is not None and not copy
    if linked and file.link is not None:
        os.link(file.link, path)  # whole or absent by itself; what was there was taken away before
        size = 0
    else:
        size = _put_bytes(path, file)
    with _counting:
        done.written += 1
        done.linked += linked
        done.bytes += size


def _put_bytes(path: Path, file: OutFile) -> int:
    temporary = temporary_path(path)
    try:
        if file.link is not None:
            shutil.copyfile(file.link, temporary)
        elif file.data is not None:
            temporary.write_bytes(file.data)
        else:
            assert file.make is not None, f"{file.path} has no content"
            temporary.write_bytes(file.make())
        size = temporary.stat().st_size
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    return size


_counting = threading.Lock()


def _can_link(file: OutFile, folder: Path) -> bool:
    """Whether a hard link from the dataset's disk to the export's is possible."""
    assert file.link is not None
    near = next(parent for parent in (folder, *folder.parents) if parent.exists())
    if near.stat().st_dev != file.link.stat().st_dev:
        return False
    try:
        with tempfile.TemporaryDirectory(prefix=".tagmill-link-", dir=near) as trial:
            os.link(file.link, Path(trial) / "link")
    except OSError as error:
        return error.errno not in (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP)
    return True


def _room(prepared: Prepared) -> None:
    near = next(parent for parent in (prepared.folder, *prepared.folder.parents) if parent.exists())
    free = shutil.disk_usage(near).free
    if prepared.need and prepared.need + RESERVE_BYTES > free:
        raise NoSpaceError(
            f"the export needs about {prepared.need / 1e6:.0f} MB, {near} has {free / 1e6:.0f} MB free; nothing was "
            f"written: free some, or choose another folder",
            code="bad_out",
        )


def _clear_temporaries(folder: Path, prepared: Prepared) -> None:
    """Remove what a kill left half-written in the folders of the export."""
    if prepared.before is None:
        return
    for parent in {(folder / path).parent for path in prepared.before.files}:
        if parent.is_dir():
            for path in parent.iterdir():
                if is_temporary(path.name):
                    path.unlink()


def _no_two(files: Sequence[OutFile]) -> None:
    seen: set[str] = set()
    for file in files:
        path = str(file.path).casefold()
        assert path not in seen, f"two files of the export are named {file.path}"
        seen.add(path)


def _parallel(do: Callable[[S], T], items: Sequence[S], workers: int, tick: Tick) -> list[T]:
    """``do`` it for each on threads, results in their order; the first error (or Ctrl-C) ends what has not begun."""
    pool = ThreadPoolExecutor(workers)
    futures: list[Future[T]] = []
    try:
        futures = [pool.submit(do, item) for item in items]
        for future in as_completed(futures):
            future.result()
            tick()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return [future.result() for future in futures]
