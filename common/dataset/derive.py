"""A new session out of samples of others: pictures are linked, labels written anew, the sources stay as they are.

The new session is made beside its place under a hidden name and moved there, durable, at the end: a kill leaves no
half of it (what is left under the hidden name goes with the next attempt). To undo it is to remove its folder.

Ledgers go with the samples: a recording of which a sample is taken comes whole, and those of its samples that were
not taken are named in the new bin's ``removed.jsonl``, so that its account adds up (they count as ``deleted``).
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.clock import iso_utc, wall_ns
from common.config.differences import differences
from common.dataset.bin import bin_of, labelled
from common.dataset.durable import make_folder, sync_folder, write_bytes
from common.dataset.emptied import REMOVED_FILE, removed
from common.dataset.head import recording_of
from common.dataset.layout import LABELS, PICTURES, RECORDS_FILE, SESSION_FILE, PictureKind, label_path
from common.dataset.locks import SESSION_BUSY, FolderLock
from common.dataset.reader import SessionReader
from common.dataset.session import SessionCamera, SessionFile
from common.errors import RefusedError
from common.labels import Label, StoredFile
from common.ledgers import CameraLedger, Ledger

SESSION_DIFFERS, SESSION_EXISTS = "session_differs", "session_exists"
_NO_LINKS = {errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP, errno.EOPNOTSUPP}


@dataclass(frozen=True, eq=False)
class Taken:
    """Samples of one session (``folder``) that are taken over; None: all of them."""

    folder: Path
    samples: tuple[str, ...] | None = None


def derive(
    target: Path,
    sources: Sequence[Taken],
    relabel: Callable[[Label], Label] = lambda label: label,
    describe: Callable[[dict[str, Any]], dict[str, Any]] = lambda rig: rig,
) -> int:
    """Make the session ``target``; returns how many samples it has.

    ``relabel`` changes each label, ``describe`` the rig to go with it. Raises RefusedError (``session_exists``,
    ``session_busy`` where a running stack has a source open, ``session_differs``, ``no_sample``), DatasetError for a
    source that can't be read, OSError.
    """

    def describe_file(file: SessionFile) -> SessionFile:
        return file.model_copy(update={"rig": describe(file.rig)})

    with making(target, [source.folder for source in sources]) as staging:
        readers = [SessionReader(source.folder) for source in sources]
        _agree(readers)
        taken: dict[str, str | None] = {}
        for source, reader in zip(sources, readers, strict=True):
            for sample in source.samples if source.samples is not None else reader.samples():
                if sample in taken:
                    raise RefusedError(f"sample {sample} is in two of the sessions", code="refused")
                label = reader.label(sample)
                link_pictures(staging, reader, label)
                changed = relabel(label.model_copy(update={"session": target.name}))
                _write(staging / label_path(sample), changed.model_dump_json(by_alias=True, indent=1).encode() + b"\n")
                taken[sample] = label.recording
        whole = all(source.samples is None for source in sources)
        describe_session(staging, target.name, readers, taken, whole=whole, describe=describe_file)
    return len(taken)


@contextmanager
def making(target: Path, sources: Sequence[Path], *, goes_on: Callable[[Path], bool] | None = None) -> Iterator[Path]:
    """The hidden folder in which a session is made; at the end it becomes ``target``, durably.

    The sources are locked against a stack meanwhile. What an earlier attempt left there is removed, unless it
    ``goes_on`` from it: then it also stays when this attempt fails. Raises RefusedError as `derive`, OSError.
    """
    if target.exists():
        raise RefusedError(f"there is a session {target.name} in {target.parent} already", code=SESSION_EXISTS)
    with ExitStack() as held:
        for source in sources:
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


def describe_session(
    staging: Path,
    name: str,
    readers: Sequence[SessionReader],
    taken: Mapping[str, str | None],
    *,
    whole: bool,
    describe: Callable[[SessionFile], SessionFile],
) -> None:
    """Write what a session has beside its samples, durably: ``session.json``, the requests, what was not taken.

    ``taken``: each sample's recording. ``whole``: recordings of which no sample was taken come too.
    """
    files = [reader.session for reader in readers]
    kept = {recording for recording in taken.values() if recording is not None}
    if whole:
        kept |= {recording for file in files for recording in file.recordings}
    lines = _request_lines(readers, kept, whole=whole)
    session = describe(_session_file(name, files, kept, lines))
    gone = {sample: rec for sample, rec in _known(readers).items() if sample not in taken and rec in kept}
    if gone:
        make_folder(bin_of(staging))
        rows = [json.dumps({"sample": sample, "recording": rec}) for sample, rec in sorted(gone.items())]
        write_bytes(bin_of(staging) / REMOVED_FILE, "".join(f"{row}\n" for row in rows).encode())
    if lines:
        write_bytes(staging / RECORDS_FILE, b"".join(line + b"\n" for line in lines))
    for folder in ("rgb", "depth", LABELS, "original"):
        if folder != "original" or (staging / folder).exists():
            make_folder(staging / folder)
            sync_folder(staging / folder)
    write_bytes(staging / SESSION_FILE, session.to_bytes())


def _agree(readers: Sequence[SessionReader]) -> None:
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
        try:
            os.link(reader.path(file), there)
        except FileNotFoundError:
            raise RefusedError(
                f"{reader.folder.name}: {file.path} is missing; 'tagmill inspect {reader.folder.name} --repair' first",
                code="missing_file",
            ) from None
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            _write(there, reader.path(file).read_bytes())
    return found


def _write(path: Path, data: bytes) -> None:
    """As `write_bytes` without the rename and the folder: nobody knows of it yet, the folders are synced at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _known(readers: Sequence[SessionReader]) -> dict[str, str | None]:
    """Every sample that the sources ever had, with its recording."""
    found: dict[str, str | None] = {}
    for reader in readers:
        found |= removed(reader.folder)
        for folder in (bin_of(reader.folder), reader.folder):
            found |= {sample: recording_of(folder, sample) for sample in labelled(folder)}
    return found


def _request_lines(readers: Sequence[SessionReader], kept: set[str], *, whole: bool) -> list[bytes]:
    """The lines of ``records.jsonl`` that are taken over, each once."""
    found: dict[bytes, None] = {}
    for reader in readers:
        path = reader.folder / RECORDS_FILE
        for line in path.read_bytes().splitlines() if path.exists() else ():
            recording = _recording_of_line(line)
            if recording is not None and (whole or recording in kept):
                found[line] = None
    return list(found)


def _recording_of_line(line: bytes) -> str | None:
    """None for a line that a kill cut off."""
    try:
        return Ledger.model_validate_json(line).spec.recording
    except ValueError:
        return None


def _session_file(name: str, files: Sequence[SessionFile], kept: set[str], lines: Sequence[bytes]) -> SessionFile:
    recordings: dict[str, Ledger] = {}
    cameras: dict[str, tuple[SessionCamera, ...]] = {}
    rig = dict(files[0].rig)
    for file in files:
        recordings |= {key: value for key, value in file.recordings.items() if key in kept}
        for camera, described in file.cameras.items():
            both = dict.fromkeys((*(one.model_dump_json() for one in (*cameras.get(camera, ()), *described)),))
            known = [SessionCamera.model_validate_json(text) for text in both]
            cameras[camera] = tuple(sorted(known, key=lambda one: one.since))
        rig["cameras"] = {**(file.rig.get("cameras") or {}), **(rig.get("cameras") or {})}
    return SessionFile(
        name=name,
        created_at=iso_utc(wall_ns()),
        rig=rig,
        versions=files[0].versions,
        cameras=cameras,
        recordings=recordings,
        progress={key: value for file in files for key, value in file.progress.items() if key in kept},
        records=dict(_sums(lines)),
    )


def _sums(lines: Sequence[bytes]) -> Iterator[tuple[str, CameraLedger]]:
    """The accounts of the single requests, added up by camera."""
    accounts: dict[str, list[CameraLedger]] = {}
    for line in lines:
        for camera, account in Ledger.model_validate_json(line).cameras.items():
            accounts.setdefault(camera, []).append(account)
    for camera, rows in accounts.items():
        plain: dict[str, Any] = {
            key: sum(getattr(row, key) for row in rows) for key in ("captured", "labelled", "recorded", "deleted")
        }
        for key in ("detected", "refused", "dropped"):
            names = {name for row in rows for name in getattr(row, key)}
            plain[key] = {name: sum(getattr(row, key).get(name, 0) for row in rows) for name in sorted(names)}
        yield camera, CameraLedger.model_validate(plain)
