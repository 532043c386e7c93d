"""A new session out of samples of others: pictures are linked, labels written anew, the sources stay as they are.

The new session is made beside its place under a hidden name and moved there, durable, at the end: a kill leaves no
half of it (what is left under the hidden name goes with the next attempt). To undo it is to remove its folder.

Ledgers go with the samples: a recording of which a sample is taken comes whole, and those of its samples that were
not taken are named in the new bin's ``removed.jsonl``, so that its account adds up (they count as ``deleted``).

A source may be a session into which a running stack records: what is taken is as it was at one moment (`Snapshot`).
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.config.differences import differences
from common.dataset.derived_session import describe_session
from common.dataset.durable import sync_folder
from common.dataset.layout import PICTURES, PictureKind, label_path
from common.dataset.locks import SESSION_BUSY, FolderLock
from common.dataset.reader import SessionReader
from common.dataset.session import SessionFile
from common.dataset.snapshot import Snapshot
from common.errors import RefusedError
from common.labels import Label, StoredFile

SESSION_DIFFERS, SESSION_EXISTS = "session_differs", "session_exists"
_TRIES = 3
"""A picture may move to the bin, or back, between the look for it and its link."""
_NO_LINKS = {errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP, errno.EOPNOTSUPP}


@dataclass(frozen=True, eq=False)
class Taken:
    """Samples of one session (``source``) that are taken over; None: all of them."""

    source: Snapshot
    samples: tuple[str, ...] | None = None


def derive(
    target: Path,
    sources: Sequence[Taken],
    relabel: Callable[[Label], Label] = lambda label: label,
    describe: Callable[[dict[str, Any]], dict[str, Any]] = lambda rig: rig,
) -> int:
    """Make the session ``target``; returns how many samples it has.

    ``relabel`` changes each label, ``describe`` the rig to go with it. Raises RefusedError (``session_exists``,
    ``session_differs``, ``missing_file``), DatasetError for a source that can't be read, OSError.
    """

    def describe_file(file: SessionFile) -> SessionFile:
        return file.model_copy(update={"rig": describe(file.rig)})

    with making(target) as staging:
        readers = [one.source for one in sources]
        _agree(readers)
        taken: dict[str, str | None] = {}
        for one in sources:
            reader = one.source
            for sample in one.samples if one.samples is not None else reader.samples():
                if sample in taken:
                    raise RefusedError(f"sample {sample} is in two of the sessions", code="refused")
                label = reader.label(sample)
                link_pictures(staging, reader, label)
                changed = relabel(label.model_copy(update={"session": target.name}))
                _write(staging / label_path(sample), changed.model_dump_json(by_alias=True, indent=1).encode() + b"\n")
                taken[sample] = label.recording
        whole = all(one.samples is None for one in sources)
        describe_session(staging, target.name, readers, taken, whole=whole, describe=describe_file)
    return len(taken)


@contextmanager
def making(
    target: Path, locked: Sequence[Path] = (), *, goes_on: Callable[[Path], bool] | None = None
) -> Iterator[Path]:
    """The hidden folder in which a session is made; at the end it becomes ``target``, durably.

    Sessions that are ``locked`` no stack may open meanwhile, or have open (``session_busy``). What an earlier attempt
    left there is removed, unless it ``goes_on`` from it: then it also stays when this attempt fails. Raises
    RefusedError as `derive`, OSError.
    """
    if target.exists():
        raise RefusedError(f"there is a session {target.name} in {target.parent} already", code=SESSION_EXISTS)
    with ExitStack() as held:
        for source in locked:
            held.enter_context(_reading(source))
        staging = target.with_name(f".{target.name}.part")
        staging.mkdir(exist_ok=True)
        held.enter_context(FolderLock(staging))
        if goes_on is None or not goes_on(staging):
            for left in staging.iterdir():
                shutil.rmtree(left) if left.is_dir() else left.unlink()
        try:
            yield staging
            staging.rename(target)
        except BaseException:
            if goes_on is None:
                shutil.rmtree(staging, ignore_errors=True)
            raise
        sync_folder(target.parent)


def _reading(folder: Path) -> FolderLock:
    try:
        return FolderLock(folder, shared=True)
    except RefusedError:
        raise RefusedError(
            f"a running stack has the session {folder.name} open, so it still grows; open another session there "
            "('tagmill session NAME') or end it ('tagmill down'), then try again",
            code=SESSION_BUSY,
        ) from None


def _agree(readers: Sequence[Snapshot]) -> None:
    files = [reader.session for reader in readers]
    for reader, file in zip(readers[1:], files[1:], strict=True):
        found = differences(files[0].rig, file.rig)
        if found:
            more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
            raise RefusedError(
                f"{readers[0].folder.name} and {reader.folder.name} were recorded with different rigs: "
                f"{found[0]}{more}; they can't be one session",
                code=SESSION_DIFFERS,
            )


def link_pictures(
    staging: Path, reader: SessionReader, label: Label, kinds: Sequence[PictureKind] = PICTURES
) -> dict[PictureKind, StoredFile]:
    """Link a sample's pictures (they are never changed in place); copied where the file system has no links.

    Those that are there already stay. Their names are not synced. Raises RefusedError ``missing_file``, OSError.
    """
    found: dict[PictureKind, StoredFile] = {}
    for kind in kinds:
        file = reader.stored(label, kind)
        if file is None:
            continue
        found[kind] = file
        there = staging / file.path
        if there.exists():
            if there.stat().st_size == file.size:
                continue
            there.unlink()  # a copy that was cut off
        there.parent.mkdir(parents=True, exist_ok=True)
        _link(reader, file, there)
    return found


def _link(reader: SessionReader, file: StoredFile, there: Path) -> None:
    for _ in range(_TRIES):
        try:
            os.link(reader.path(file), there)
        except FileNotFoundError:
            continue
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            _write(there, reader.path(file).read_bytes())
        return
    raise RefusedError(
        f"{reader.folder.name}: {file.path} is missing; 'tagmill inspect {reader.folder.name} --repair' first",
        code="missing_file",
    )


def _write(path: Path, data: bytes) -> None:
    """As `write_bytes` without the rename and the folder: nobody knows of it yet, the folders are synced at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
