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
    assert result["counts"]["samples"] >= 10
    assert check(kept, "chaos").violations == []
    for plant, said in PLANTS.items():
        copy = tmp_path / plant.__name__
        shutil.copytree(kept, copy)
        plant(Run(copy))
        found = check(copy, "chaos").violations
        assert any(said in one for one in found), (plant.__name__, found)
        shutil.rmtree(copy)


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
    """A kept run, for planting what must not be."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session = folder / "disk" / "dataset" / "chaos"
        self.labels = sorted((self.session / "label").glob("*.json"))

    def label(self, number: int = 0) -> dict[str, Any]:
        plain: dict[str, Any] = json.loads(self.labels[number].read_text())
        return plain

    def write_label(self, label: dict[str, Any], number: int = 0) -> None:
        self.labels[number].write_text(json.dumps(label))

    def picture(self, kind: str, number: int = 0) -> Path:
        return self.session / str(self.label(number)["files"][kind]["path"])

    def put(self, kind: str, data: bytes) -> None:
        """Other pixels in the first sample, with the size and checksum that belong to them."""
        label = self.label()
        self.picture(kind).write_bytes(data)
        label["files"][kind] |= {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        self.write_label(label)

    def other(self) -> int:
        """The number of a sample of the same camera that shows another step of its path."""
        frames = [round(self.label(number)["device_ns"] / 1e8) % 14 for number in range(len(self.labels))]
        steps = [min(frame, 14 - frame) for frame in frames]
        names = [self.label(number)["camera"]["name"] for number in range(len(self.labels))]
        return next(n for n in range(len(steps)) if names[n] == names[0] and abs(steps[n] - steps[0]) > 1)

    def session_file(self, change: Callable[[dict[str, Any]], None]) -> None:
        path = self.session / "session.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    def journal(self, entry: dict[str, Any]) -> None:
        with (self.folder / "answers.jsonl").open("a") as file:
            file.write(json.dumps({"at_ns": 1, "sent_ns": 0, **entry}) + "\n")


def account(document: dict[str, Any]) -> dict[str, Any]:
    """A camera's account of some recording."""
    ledger = next(one for one in document["recordings"].values() if any(one["cameras"].values()))
    found: dict[str, Any] = next(iter(ledger["cameras"].values()))
    return found


def a_lost_sample(run: Run) -> None:
    run.journal({"request": {"command": "record"}, "answer": {"ok": True, "samples": [run.label()["sample"]]}})
    run.labels[0].unlink()


def an_orphaned_picture(run: Run) -> None:
    run.labels[0].unlink()


def a_torn_file(run: Run) -> None:
    path = run.picture("rgb")
    path.write_bytes(path.read_bytes()[:-7])


def a_torn_label(run: Run) -> None:
    run.labels[0].write_text(run.labels[0].read_text()[:300])


def a_temporary_file(run: Run) -> None:
    (run.session / "rgb" / ".rgb_x.png.tmp").write_bytes(b"half")


def another_frames_picture(run: Run) -> None:
    run.put("rgb", run.picture("rgb", run.other()).read_bytes())


def another_frames_depth(run: Run) -> None:
    run.put("depth", run.picture("depth", run.other()).read_bytes())


def half_of_another_frame(run: Run) -> None:
    here, there = (cv2.imread(str(run.picture("original", number))) for number in (0, run.other()))
    here[200:] = there[200:]
    run.put("original", cv2.imencode(".png", here)[1].tobytes())


def a_spoilt_picture(run: Run) -> None:
    picture = cv2.imread(str(run.picture("rgb")))
    picture[-9:-1, 3:9] ^= 255
    run.put("rgb", cv2.imencode(".png", picture)[1].tobytes())


def another_frames_markers(run: Run) -> None:
    label = run.label()
    for key in ("objects", "left_out"):
        label[key] = run.label(run.other())[key]
    run.write_label(label)


def another_samples_label(run: Run) -> None:
    run.write_label(run.label(run.other()))


def a_frame_that_nobody_accounts_for(run: Run) -> None:
    run.session_file(lambda document: account(document).update(captured=account(document)["captured"] + 1))


def a_sample_that_the_ledger_lacks(run: Run) -> None:
    """Recorded, says the disk; refused, says the ledger."""

    def change(document: dict[str, Any]) -> None:
        for ledger in document["recordings"].values():
            for one in ledger["cameras"].values():
                one["refused"]["elsewhere"] = one["recorded"]
                one["recorded"] = 0

    run.session_file(change)


def a_sample_that_is_pending_for_ever(run: Run) -> None:
    run.session_file(lambda document: account(document).update(pending=1))


def a_recording_that_never_ends(run: Run) -> None:
    run.session_file(lambda document: next(iter(document["recordings"].values())).update(phase="running"))


def a_sample_of_no_recording(run: Run) -> None:
    run.write_label(run.label() | {"recording": "rec-nobody"})


def a_stop_that_lied(run: Run) -> None:
    document = json.loads((run.session / "session.json").read_text())
    ledger = next(one for one in document["recordings"].values() if any(one["cameras"].values()))
    told = json.loads(json.dumps(ledger)) | {"phase": "ended"}
    next(iter(told["cameras"].values()))["recorded"] += 1
    run.journal({"request": {"command": "stop"}, "answer": {"ok": True, "ledgers": [told]}})


def a_stack_that_did_not_come_back(run: Run) -> None:
    run.journal({"not_recovered": "store is faulty"})


PLANTS: dict[Callable[[Run], None], str] = {
    a_lost_sample: "was acknowledged and is not whole on the disk",
    an_orphaned_picture: "belongs to no sample",
    a_torn_file: "is torn",
    a_torn_label: "can't be read",
    a_temporary_file: ".rgb_x.png.tmp belongs to no sample",
    another_frames_picture: "its rgb picture is of frame",
    another_frames_depth: "its depth is not wholly",
    half_of_another_frame: "its original is not wholly",
    a_spoilt_picture: "differs from the original outside",
    another_frames_markers: "its markers are where step",
    another_samples_label: "its label says",
    a_frame_that_nobody_accounts_for: "accounted for",
    a_sample_that_the_ledger_lacks: "0 recorded",
    a_sample_that_is_pending_for_ever: "pending for ever",
    a_recording_that_never_ends: "is still running",
    a_sample_of_no_recording: "are in no ledger",
    a_stop_that_lied: "said {'captured'",
    a_stack_that_did_not_come_back: "not recovered",
}
