"""`tagmill bench chaos`: the short form finds nothing wrong; and its judge finds each wrong that is planted."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.hygiene import Place
from tests.support.supervised import run_module
from tools.bench.chaos.checker import check

pytestmark = [pytest.mark.process, pytest.mark.timeout(1200)]

SEED, FAULTS = "137", "7"


def test_the_short_form_loses_nothing_and_the_judge_would_have_seen_it(tmp_path: Path, place: Place) -> None:
    kept = tmp_path / "kept"
    _, done = run_module(
        *("tools", "bench", "chaos", "--short", "--seed", SEED, "--faults", FAULTS, "--keep", str(kept), "--json"),
        timeout_s=1100,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    result = json.loads(done.stdout)
    assert result["violations"] == []
    assert result["faults"] + result["left_out"] == int(FAULTS)
    assert result["counts"]["acknowledged"] > 0
    assert result["counts"]["samples"] >= 16
    assert check(kept, "chaos").violations == []
    run = Run(kept)
    wanted = [(plant.__name__, run.name(number), plant(run, number)) for number, plant in enumerate(IN_A_SAMPLE)]
    wanted += [(plant.__name__, "", plant(run)) for plant in ELSEWHERE]
    found = check(kept, "chaos").violations
    missed = [name for name, sample, said in wanted if not any(sample in one and said in one for one in found)]
    assert missed == [], found


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_two_hundred_faults() -> None:
    _, done = run_module("tools", "bench", "chaos", "--seed", "1", "--faults", "200", "--json", timeout_s=7000)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


def test_the_judge_sees_what_a_stack_leaves(tmp_path: Path, place: Place) -> None:
    from tools.bench.chaos.check_traces import check_traces

    shm, run_dir = tmp_path / "shm", place.run_root / "judged"
    shm.mkdir()
    run_dir.mkdir(parents=True)
    assert check_traces(shm, "judged", run_dir) == []
    (shm / "tagmill-judged-cam0-00000001").touch()
    (run_dir / "control.lock").touch()
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(run_dir / "command"))
    sleeper = subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.stdin.read()"],
        env={**os.environ, "TAGMILL_PREFIX": "judged"},
        stdin=subprocess.PIPE,
    )
    try:
        found = check_traces(shm, "judged", run_dir)
    finally:
        sleeper.kill()
        sleeper.communicate()
    assert len(found) == 4, found
    for said in ("shared memory is left: tagmill-judged", "control.lock is left", "command is left", "sys.stdin.read"):
        assert any(said in one for one in found), found
    shutil.rmtree(run_dir)


class Run:
    """A kept run, for planting what must not be: each in a sample of its own, by number."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session = folder / "disk" / "dataset" / "chaos"
        self.paths = sorted((self.session / "label").glob("*.json"))
        self.labels: list[dict[str, Any]] = [json.loads(path.read_text()) for path in self.paths]
        self.pictures = {
            (kind, number): (self.session / label["files"][kind]["path"]).read_bytes()
            for number, label in enumerate(self.labels)
            for kind in ("rgb", "depth", "original")
        }

    def name(self, number: int) -> str:
        return str(self.labels[number]["sample"])

    def write_label(self, number: int, **changed: Any) -> None:
        self.paths[number].write_text(json.dumps(self.labels[number] | changed))

    def picture(self, kind: str, number: int) -> Path:
        return self.session / str(self.labels[number]["files"][kind]["path"])

    def put(self, kind: str, number: int, data: bytes) -> None:
        """Other pixels, with the size and checksum that belong to them."""
        self.picture(kind, number).write_bytes(data)
        files = self.labels[number]["files"]
        other = files[kind] | {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        self.write_label(number, files=files | {kind: other})

    def decoded(self, kind: str, number: int) -> Any:
        return cv2.imdecode(np.frombuffer(self.pictures[kind, number], np.uint8), cv2.IMREAD_UNCHANGED)

    def other(self, number: int) -> int:
        """The number of a sample of the same camera that shows another step of its path, there and back.

        From the end: the first samples each have something planted in them.
        """
        frames = [round(label["device_ns"] / 1e8) % 14 for label in self.labels]
        steps = [min(frame, 14 - frame) for frame in frames]
        names = [label["camera"]["name"] for label in self.labels]
        last_first = range(len(steps) - 1, -1, -1)
        return next(n for n in last_first if names[n] == names[number] and abs(steps[n] - steps[number]) > 1)

    def ledger(self) -> dict[str, Any]:
        document = json.loads((self.session / "session.json").read_text())
        return next(one for one in document["recordings"].values() if any(one["cameras"].values()))

    def change_ledger(self, change: Callable[[dict[str, Any]], None]) -> None:
        """Of a recording with a camera."""
        path = self.session / "session.json"
        document = json.loads(path.read_text())
        change(next(one for one in document["recordings"].values() if any(one["cameras"].values())))
        path.write_text(json.dumps(document))

    def journal(self, entry: dict[str, Any]) -> None:
        with (self.folder / "answers.jsonl").open("a") as file:
            file.write(json.dumps({"at_ns": 1, "sent_ns": 0, **entry}) + "\n")


def account(ledger: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = next(iter(ledger["cameras"].values()))
    return found


def a_lost_sample(run: Run, number: int) -> str:
    run.journal({"request": {"command": "record"}, "answer": {"ok": True, "samples": [run.name(number)]}})
    run.paths[number].unlink()
    return "was acknowledged and is not whole on the disk"


def an_orphaned_picture(run: Run, number: int) -> str:
    run.paths[number].unlink()
    return "belongs to no sample"


def a_torn_file(run: Run, number: int) -> str:
    run.picture("rgb", number).write_bytes(run.pictures["rgb", number][:-7])
    return "is torn"


def a_torn_label(run: Run, number: int) -> str:
    run.paths[number].write_text(run.paths[number].read_text()[:300])
    return "can't be read"


def another_frames_picture(run: Run, number: int) -> str:
    run.put("rgb", number, run.pictures["rgb", run.other(number)])
    return "its rgb picture is of frame"


def another_frames_depth(run: Run, number: int) -> str:
    run.put("depth", number, run.pictures["depth", run.other(number)])
    return "its depth is not wholly"


def half_of_another_frame(run: Run, number: int) -> str:
    here, there = run.decoded("original", number), run.decoded("original", run.other(number))
    here[200:] = there[200:]
    run.put("original", number, cv2.imencode(".png", here)[1].tobytes())
    return "its original is not wholly"


def a_spoilt_picture(run: Run, number: int) -> str:
    picture = run.decoded("rgb", number)
    picture[-9:-1, 3:9] ^= 255
    run.put("rgb", number, cv2.imencode(".png", picture)[1].tobytes())
    return "differs from the original outside"


def another_frames_markers(run: Run, number: int) -> str:
    there = run.labels[run.other(number)]
    run.write_label(number, objects=there["objects"], left_out=there["left_out"])
    return "its markers are where step"


def another_samples_label(run: Run, number: int) -> str:
    run.write_label(number, **run.labels[run.other(number)])
    return "its label says"


def a_sample_of_no_recording(run: Run, number: int) -> str:
    run.write_label(number, recording=f"rec-of-{run.name(number)}")
    return "are in no ledger"


IN_A_SAMPLE = (
    a_lost_sample,
    an_orphaned_picture,
    a_torn_file,
    a_torn_label,
    another_frames_picture,
    another_frames_depth,
    half_of_another_frame,
    a_spoilt_picture,
    another_frames_markers,
    another_samples_label,
    a_sample_of_no_recording,
)


def a_temporary_file(run: Run) -> str:
    (run.session / "rgb" / ".rgb_x.png.tmp").write_bytes(b"half")
    return ".rgb_x.png.tmp belongs to no sample"


def a_stop_that_lied(run: Run) -> str:
    told = run.ledger() | {"phase": "ended"}
    account(told)["recorded"] += 1
    run.journal({"request": {"command": "stop"}, "answer": {"ok": True, "ledgers": [told]}})
    return "said {'captured'"


def a_frame_that_nobody_accounts_for(run: Run) -> str:
    run.change_ledger(lambda ledger: account(ledger).update(captured=account(ledger)["captured"] + 1))
    return "accounted for"


def a_sample_that_is_pending_for_ever(run: Run) -> str:
    run.change_ledger(lambda ledger: account(ledger).update(pending=1))
    return "pending for ever"


def a_recording_that_never_ends(run: Run) -> str:
    run.change_ledger(lambda ledger: ledger.update(phase="running"))
    return "is still running"


def a_sample_that_the_ledger_lacks(run: Run) -> str:
    """Recorded, says the disk; refused, says the ledger of the last request."""
    path = run.session / "records.jsonl"
    *before, last = path.read_text().splitlines()
    entry = json.loads(last)
    account(entry)["refused"] = {"elsewhere": account(entry)["recorded"]}
    account(entry)["recorded"] = 0
    path.write_text("\n".join([*before, json.dumps(entry), ""]))
    return "0 recorded"


def a_stack_that_did_not_come_back(run: Run) -> str:
    run.journal({"not_recovered": "store is faulty"})
    return "not recovered"


ELSEWHERE = (
    a_temporary_file,
    a_stop_that_lied,
    a_frame_that_nobody_accounts_for,
    a_sample_that_is_pending_for_ever,
    a_recording_that_never_ends,
    a_sample_that_the_ledger_lacks,
    a_stack_that_did_not_come_back,
)
