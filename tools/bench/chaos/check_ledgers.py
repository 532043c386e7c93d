"""The judge's sums: every captured frame of a recording is recorded, refused or dropped, and the disk agrees."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from tools.bench.chaos.check_samples import Sample

_OVER = ("ended", "interrupted")
_ALWAYS = (0, 1 << 63)

Window = tuple[int, int]


def check_ledgers(
    session: Path, kept: dict[str, Sample], everywhere: dict[str, Sample], entries: list[dict[str, Any]]
) -> list[str]:
    """The ledgers of ``session.json`` and ``records.jsonl`` against the samples, and against what `stop` answered.

    ``kept``: the samples of this session. ``everywhere``: with those that a fault deleted; a recording that went on
    after that has them in its ledger too, for they were recorded.
    """
    try:
        document = json.loads((session / "session.json").read_text())
        ledgers = {**document["recordings"], **_requests(session / "records.jsonl")}
    except (OSError, ValueError) as error:
        return [f"the ledger of {session.name} can't be read: {error}"]
    wrong: list[str] = []
    windows = _windows(entries)
    for name, ledger in ledgers.items():
        if ledger["phase"] not in _OVER:
            wrong.append(f"recording {name} is still {ledger['phase']} after the stack has ended")
        window = windows.get(name, _ALWAYS)
        for camera, account in ledger["cameras"].items():
            own = [one for one in everywhere.values() if one.camera == camera]
            wrong += _sums(f"recording {name}, {camera}", account, *_stored(name, own, window))
    known = {(name, camera) for name, ledger in ledgers.items() for camera in ledger["cameras"]}
    unknown = {(sample.recording, sample.camera) for sample in kept.values()} - known
    wrong += [f"samples of {recording}, {camera} are in no ledger" for recording, camera in sorted(unknown, key=str)]
    return [*wrong, *_promised(ledgers, entries)]


def _requests(path: Path) -> dict[str, Any]:
    """The ledgers of single requests, a line for each camera."""
    found: dict[str, Any] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        entry = json.loads(line)
        before = found.setdefault(entry["spec"]["recording"], entry)
        before["cameras"] |= entry["cameras"]
    return found


def _windows(entries: Iterable[dict[str, Any]]) -> dict[str, Window]:
    """When a recording or request can have taken frames, by its client's clock (the machine's monotonic one)."""
    found: dict[str, Window] = {}
    for entry in entries:
        answer = entry.get("answer", {})
        if entry.get("request", {}).get("command") == "record":
            for name in answer.get("recordings", ()):
                found[name] = (entry["sent_ns"], entry["at_ns"])
        elif "recording" in answer:
            found[answer["recording"]] = (entry["sent_ns"], _ALWAYS[1])
        for ledger in answer.get("ledgers", ()) if answer.get("ok") else ():
            name = ledger["spec"]["recording"]
            found[name] = (found.get(name, _ALWAYS)[0], entry["at_ns"])
    return found


def _stored(recording: str, samples: Iterable[Sample], window: Window) -> tuple[int, int]:
    """How many of a camera's samples are the recording's, and how many others it may share.

    Two recordings that want one frame share the sample, which carries the name of only one of them.
    """
    own = shared = 0
    for sample in samples:
        if sample.recording == recording:
            own += 1
        elif window[0] <= sample.captured_ns <= window[1]:
            shared += 1
    return own, shared


def _sums(place: str, account: dict[str, Any], stored: int, shared: int) -> Iterator[str]:
    told = account["recorded"] + sum(account["refused"].values()) + sum(account["dropped"].values())
    if account["pending"]:
        yield f"{place}: {account['pending']} samples are pending for ever"
    if told != account["captured"]:
        yield f"{place}: {account['captured']} frames captured, {told} accounted for"
    if not stored <= account["recorded"] <= stored + shared:
        yield f"{place}: {account['recorded']} recorded, {stored} on the disk and {shared} that it may share"


def _promised(ledgers: dict[str, Any], entries: Iterable[dict[str, Any]]) -> Iterator[str]:
    """What `stop` answered as ended is what is written; a ledger of a deleted session is gone with it."""
    for entry in entries:
        for ledger in entry.get("answer", {}).get("ledgers", ()):
            name = ledger["spec"]["recording"]
            if name not in ledgers or ledger["phase"] != "ended":
                continue
            for camera, account in ledger["cameras"].items():
                told = {key: account[key] for key in ("captured", "recorded", "refused", "dropped")}
                is_now = {key: ledgers[name]["cameras"][camera][key] for key in told}
                if told != is_now:
                    yield f"`stop` of {name}, {camera}: said {told}, written is {is_now}"
