"""What a session made of others has beside its samples: ``session.json``, the requests, what was not taken over."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from common.clock import iso_utc, wall_ns
from common.dataset.bin import bin_of
from common.dataset.durable import make_folder, sync_folder, write_bytes
from common.dataset.emptied import REMOVED_FILE
from common.dataset.layout import LABELS, RECORDS_FILE, SESSION_FILE
from common.dataset.session import SessionCamera, SessionFile
from common.dataset.snapshot import Snapshot
from common.ids import sample_camera
from common.ledgers import ALIVE, CameraLedger, Ledger, closed, with_deleted, with_recorded


def describe_session(
    staging: Path,
    name: str,
    readers: Sequence[Snapshot],
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
    known = {sample: recording for reader in readers for sample, recording in reader.known.items()}
    gone = {sample: recording for sample, recording in known.items() if sample not in taken and recording in kept}
    session = describe(_session_file(name, readers, kept, lines, known, gone))
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


def _request_lines(readers: Sequence[Snapshot], kept: set[str], *, whole: bool) -> list[bytes]:
    """The lines of ``records.jsonl`` that are taken over, each once."""
    found: dict[bytes, None] = {}
    for reader in readers:
        for line in reader.requests:
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


def _session_file(
    name: str,
    readers: Sequence[Snapshot],
    kept: set[str],
    lines: Sequence[bytes],
    known: Mapping[str, str | None],
    gone: Mapping[str, str | None],
) -> SessionFile:
    files = [reader.session for reader in readers]
    cameras: dict[str, tuple[SessionCamera, ...]] = {}
    rig = dict(files[0].rig)
    for file in files:
        for camera, described in file.cameras.items():
            both = dict.fromkeys((*(one.model_dump_json() for one in (*cameras.get(camera, ()), *described)),))
            history = [SessionCamera.model_validate_json(text) for text in both]
            cameras[camera] = tuple(sorted(history, key=lambda one: one.since))
        rig["cameras"] = {**(file.rig.get("cameras") or {}), **(rig.get("cameras") or {})}
    return SessionFile(
        name=name,
        created_at=iso_utc(wall_ns()),
        rig=rig,
        versions=files[0].versions,
        cameras=cameras,
        recordings=_recordings(name, readers, kept, known, gone),
        progress={key: value for file in files for key, value in file.progress.items() if key in kept},
        records=dict(_sums(lines)),
    )


def _recordings(
    name: str,
    readers: Sequence[Snapshot],
    kept: set[str],
    known: Mapping[str, str | None],
    gone: Mapping[str, str | None],
) -> dict[str, Ledger]:
    """The ledgers that come along, each adding up for the samples that are durable (a file is half a second late).

    Of a recording that is in several sources comes the ledger that tells of more frames. What still runs is closed.
    """
    now, counted, deleted = iso_utc(wall_ns()), _by_camera(known), _by_camera(gone)
    found: dict[str, Ledger] = {}
    for reader in readers:
        why = f"it was still running when {name} was made of {reader.folder.resolve().name}"
        for recording, ledger in reader.session.recordings.items():
            if recording not in kept or _frames(ledger) < _frames(found.get(recording)):
                continue
            counts = counted.get(recording, Counter())
            cameras = {
                camera: with_recorded(ledger.cameras.get(camera, CameraLedger()), counts[camera])
                for camera in {**ledger.cameras, **counts}
            }
            whole = ledger.model_copy(update={"cameras": cameras})
            found[recording] = closed(whole, now, why) if whole.phase in ALIVE else whole
    return {recording: with_deleted(ledger, deleted.get(recording, {})) for recording, ledger in found.items()}


def _by_camera(samples: Mapping[str, str | None]) -> dict[str | None, Counter[str]]:
    """Of each recording, its samples by camera."""
    counts: dict[str | None, Counter[str]] = {}
    for sample, recording in samples.items():
        counts.setdefault(recording, Counter())[sample_camera(sample)] += 1
    return counts


def _frames(ledger: Ledger | None) -> int:
    return -1 if ledger is None else sum(account.captured for account in ledger.cameras.values())


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
