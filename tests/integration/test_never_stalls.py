"""A camera never stalls, not for a slow label process, not for a stopped store; and no order is left in silence.

All of it is `tagmill bench stall`, with small pictures.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from common.words import words_for
from tests.support.supervised import check_session, run_module
from tools.bench.stall import SESSION

pytestmark = [pytest.mark.process, pytest.mark.timeout(600)]


def stall(folder: Path, size: str, fps: int, *options: str) -> dict[str, Any]:
    """Its document, after what holds of any machine was looked at."""
    kept = folder / "kept"
    words = ("--size", size, "--fps", str(fps), "--keep", str(kept), "--json", *options)
    _, done = run_module("tools", "bench", "stall", *words, timeout_s=560)
    assert done.returncode in (0, 5), done.stdout + done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    assert document["complaints"] == [], done.stderr
    assert set(document["cameras"]) == set(document["ledgers"]) == {"cam0", "cam1"}
    before, during = list(document["phases"].values())[:2]
    for name, camera in document["cameras"].items():
        assert camera["unheard"] == 0
        # Who waits for a stopped service gives nothing; a starved machine gives both phases less.
        assert 3 * rate(during, name) > rate(before, name) > 0, document["phases"]
    assert (done.returncode == 5) is any(camera["dropped"] for camera in document["cameras"].values())
    check_session(kept / "dataset" / SESSION)
    return document


def rate(phase: dict[str, Any], camera: str) -> float:
    """Frames a second."""
    return float(phase["jitter"][camera]["intervals"] / phase["seconds"])


def check_orders(document: dict[str, Any]) -> None:
    """Each order had its answer: samples, or a refusal with a reason that a person understands."""
    assert document["orders"]
    for outcome in document["orders"]:
        what, _, code = outcome.partition(": ")
        assert what == "stored" or (what == "refused" and words_for(code).what_to_do), outcome


def test_two_cameras_beside_a_slow_label_process_and_a_stopped_store(tmp_path: Path) -> None:
    document = stall(tmp_path, "320x240", 15, "--seconds", "3", "--stopped", "6")
    check_orders(document)
    assert document["on_disk"] >= 2  # the last order, of both cameras
    assert list(document["phases"]) == ["nothing recorded", "store stopped", "going on"]


@pytest.mark.long
@pytest.mark.parametrize("service", ["detect.0", "label.0"])
def test_two_cameras_beside_a_stopped_reader_of_their_frames(service: str, tmp_path: Path) -> None:
    fast = ("--label-delay-ms", "0", "--seconds", "3", "--stopped", "6")
    check_orders(stall(tmp_path, "640x360", 15, "--stop", service, *fast))


@pytest.mark.long
def test_two_720p_cameras_for_twenty_seconds(tmp_path: Path) -> None:
    document = stall(tmp_path, "1280x720", 30, "--seconds", "6", "--stopped", "20")
    check_orders(document)
    for name, camera in document["cameras"].items():
        assert camera["captured"] >= 0.99 * camera["offered"], (name, camera)
