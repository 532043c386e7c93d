"""Faults planted into a recorded session must be among the first that `tagmill inspect` shows."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest

from common.dataset import SessionReader
from common.errors import EXIT_OK
from tests.support.faults import FAULTS, moved, picture_of, plant
from tests.support.rendered_session import Plan, record_session
from tools.cli import main

SMALL = ("moved aside", "half a marker left", "large residual", "other depth", "other side", "object gone")


def inspect(folder: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The suspicious samples, the most suspicious first."""
    assert main(["inspect", str(folder), "--out", str(out), "--json"]) == EXIT_OK
    document = json.loads(capsys.readouterr().out)
    assert document["summary"]["samples"] == len(SessionReader(folder).samples())
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    return [one["sample"] for one in document["suspicious"]]


def test_eight_faults_in_twenty_four_samples_are_among_the_first_twelve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "session"
    record_session(Plan(folder, width=480, height=270), 24, workers=1)
    faults = [fault for fault in FAULTS if fault[0] in (*SMALL, "other picture", "window only")]
    planted = plant(folder, range(1, 23, 3), faults)
    first = inspect(folder, tmp_path / "report", capsys)[:12]
    assert {name: fault for name, fault in planted.items() if name not in first} == {}


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_twenty_faults_in_449_samples_are_among_the_first_thirty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "session"
    names = record_session(Plan(folder), 449)
    assert len(names) == 449
    where = Random(3).sample(range(2, 447), len(FAULTS))
    planted = plant(folder, where)
    first = inspect(folder, tmp_path / "report", capsys)[:30]
    assert {name: fault for name, fault in planted.items() if name not in first} == {}


@pytest.mark.long
def test_with_the_originals_a_moved_label_and_another_picture_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "session"
    names = record_session(Plan(folder, width=480, height=270, original=True), 7, workers=1)
    plant(folder, (2, 5), (("moved", moved((15.0, 0.0, 0.0))), ("other picture", picture_of(3))))
    assert main(["inspect", str(folder), "--out", str(tmp_path / "report"), "--json"]) == EXIT_OK
    found = {
        one["sample"]: {why["kind"] for why in one["reasons"]}
        for one in json.loads(capsys.readouterr().out)["suspicious"]
    }
    assert "original" in found[names[2]]
    assert "changed" in found[names[5]]
    assert set(found) == {names[2], names[5]}
