"""`tagmill dataset` on a folder without a stack: moves, lists, refusals, the lock, emptying the bin."""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path

import pytest

from common.dataset import label_path
from common.dataset.bin import bin_of
from common.dataset.locks import FolderLock
from common.errors import EXIT_BAD_CONFIG, EXIT_OK, EXIT_REFUSED, EXIT_USAGE
from tests.support.sessions import frames, make_session, places
from tools.cli import main

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three samples in ``dataset/monday``, below a rig file that is wrong elsewhere."""
    (tmp_path / "rig.yaml").write_text("dataset: {root: ./dataset, session: monday}\nobjects: 17\n")
    make_session(tmp_path / "dataset" / "monday", *frames(1, 2, 3))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path / "dataset" / "monday"


def newest_first(session: Path) -> list[str]:
    return sorted(places(session), reverse=True)


def test_delete_list_and_restore(session: Path, capsys: Captured) -> None:
    three, two, one = newest_first(session)
    assert main(["dataset", "delete", one, three]) == EXIT_OK
    assert capsys.readouterr().out == "2 samples are in the bin (session monday)\n"
    assert places(session) == {one: "bin", two: "session", three: "bin"}
    assert main(["dataset", "list"]) == EXIT_OK
    shown = capsys.readouterr().out
    assert two in shown
    assert "1 of 1 that match, 1 in monday; 2 in the bin" in shown
    assert main(["dataset", "list", "--bin", "--names"]) == EXIT_OK
    assert capsys.readouterr().out.splitlines() == [three, one]
    assert main(["dataset", "restore", one, "--json"]) == EXIT_OK
    assert json.loads(capsys.readouterr().out) == {"ok": True, "samples": [one]}
    assert main(["dataset", "list", "--side", "lid", "--json"]) == EXIT_OK
    assert json.loads(capsys.readouterr().out)["total"] == 0


def test_names_come_from_stdin_too(session: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    three, two, one = newest_first(session)
    monkeypatch.setattr(sys, "stdin", io.StringIO(f"{one}\n\n  {two}\n"))
    assert main(["dataset", "delete", "-"]) == EXIT_OK
    assert places(session) == {one: "bin", two: "bin", three: "session"}
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main(["dataset", "delete", "-"]) == EXIT_OK
    assert "0 samples are in the bin" in capsys.readouterr().out


def test_a_session_is_named_or_its_folder_is(session: Path, tmp_path: Path, capsys: Captured) -> None:
    make_session(tmp_path / "dataset" / "tuesday", *frames(8))
    for name in ("tuesday", str(tmp_path / "dataset" / "tuesday"), "dataset/tuesday"):
        assert main(["dataset", "list", "--json", "--session", name]) == EXIT_OK
        answer = json.loads(capsys.readouterr().out)
        assert (answer["session"], answer["total"]) == ("tuesday", 1)


@pytest.mark.parametrize(
    ("words", "told", "code"),
    [
        (["delete", "nothing"], "monday has no sample nothing; nothing was moved", EXIT_REFUSED),
        (["restore", "../../x"], "monday has no sample ../../x", EXIT_REFUSED),
        (["list", "--session", "nowhere"], "there is no session nowhere in", EXIT_REFUSED),
        (["list", "--limit", "-1"], "--offset and --limit must be 0 or more", EXIT_REFUSED),
        (["list", "--min-distance-mm", "-5"], "--min-distance-mm: Input should be greater", EXIT_REFUSED),
        (["list", "--rig", "no.yaml"], "no.yaml: there is no such file", EXIT_BAD_CONFIG),
    ],
)
def test_mistakes_are_told_and_change_nothing(
    session: Path, words: list[str], told: str, code: int, capsys: Captured
) -> None:
    before = places(session)
    assert main(["dataset", *words]) == code
    assert told in capsys.readouterr().err
    assert places(session) == before


def test_wrong_usage_is_exit_code_2(session: Path) -> None:
    assert main(["dataset"]) == EXIT_USAGE
    for words in (["delete"], ["list", "--limit", "many"]):
        with pytest.raises(SystemExit) as end:
            main(["dataset", *words])
        assert end.value.code == EXIT_USAGE


def test_a_rig_file_without_a_readable_dataset_is_told(session: Path, tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "rig.yaml").write_text("dataset: {rot: 3}\n")
    assert main(["dataset", "list"]) == EXIT_BAD_CONFIG
    assert "tagmill check" in capsys.readouterr().err


def test_who_writes_to_the_session_keeps_it(session: Path, capsys: Captured) -> None:
    one = newest_first(session)[0]
    with FolderLock(session):
        for words in (["delete", one], ["empty-bin", "--yes"]):
            assert main(["dataset", *words]) == EXIT_REFUSED
            assert "being written by another tagmill" in capsys.readouterr().err
        assert main(["dataset", "list"]) == EXIT_OK, "whoever only reads needs no lock"
    assert set(places(session).values()) == {"session"}


def test_what_a_kill_cut_off_is_finished_first(session: Path) -> None:
    three, two, one = newest_first(session)
    assert main(["dataset", "delete", one]) == EXIT_OK
    (session / label_path(two)).rename(bin_of(session) / label_path(two))
    assert main(["dataset", "restore", one]) == EXIT_OK
    assert places(session) == {one: "session", two: "bin", three: "session"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_can_not_be_written_is_told(session: Path, capsys: Captured) -> None:
    session.chmod(0o555)
    try:
        assert main(["dataset", "delete", newest_first(session)[0]]) == EXIT_REFUSED
    finally:
        session.chmod(0o755)
    assert "can't be written" in capsys.readouterr().err


def test_the_bin_is_emptied_only_if_that_is_meant(session: Path, capsys: Captured) -> None:
    three, two, one = newest_first(session)
    assert main(["dataset", "empty-bin", "--yes"]) == EXIT_OK, "an empty one too"
    assert main(["dataset", "delete", one, two]) == EXIT_OK
    capsys.readouterr()
    assert main(["dataset", "empty-bin"]) == EXIT_OK
    assert capsys.readouterr().out.startswith("2 in the bin of monday")
    assert places(session) == {one: "bin", two: "bin", three: "session"}
    assert main(["dataset", "empty-bin", "--yes", "--json"]) == EXIT_OK
    told = json.loads(capsys.readouterr().out)
    assert (told["removed"], told["samples"]) == (True, [one, two])
    assert told["bytes"] > 0
    assert places(session) == {three: "session"}
    assert main(["dataset", "restore", one]) == EXIT_REFUSED
