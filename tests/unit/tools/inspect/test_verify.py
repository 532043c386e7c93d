"""`inspect --verify` and `--repair`: every kind of damage is told, moved away and brought back."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common.dataset import SessionReader, label_path, picture_path
from common.dataset.locks import FolderLock
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_REFUSED
from tests.support.sessions import frames, make_session, places
from tools.cli import main

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    make_session(tmp_path / "dataset" / "monday", *frames(1, 2, 3))
    return tmp_path / "dataset" / "monday"


def verified(session: Path, capsys: Captured, *words: str) -> tuple[int, dict[str, object]]:
    capsys.readouterr()
    code = main(["inspect", str(session), "--verify", "--json", *words])
    return code, json.loads(capsys.readouterr().out)


def kinds(answer: dict[str, object]) -> list[str]:
    return [one["kind"] for one in answer["problems"]]  # type: ignore[attr-defined]


def test_a_whole_session_is_all_right(session: Path, capsys: Captured) -> None:
    assert main(["inspect", str(session), "--verify"]) == EXIT_OK
    assert "3 samples of monday: every file opens" in capsys.readouterr().out


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:200])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("what", "damage", "kind"),
    [
        ("rgb", Path.unlink, "missing_file"),
        ("depth", Path.unlink, "missing_file"),
        ("original", truncate, "damaged"),
        ("rgb", flip, "damaged"),
        ("rgb", lambda path: path.write_bytes(b""), "damaged"),
        ("label", truncate, "label"),
        ("label", lambda path: path.write_bytes(b"\xff\xfe"), "label"),
        (
            "label",
            lambda path: path.write_text(path.read_text().replace("tagmill.label/1", "tagmill.label/9")),
            "label",
        ),
    ],
)
def test_damage_is_told_moved_and_brought_back(
    session: Path, what: str, damage: object, kind: str, capsys: Captured
) -> None:
    sample = SessionReader(session).samples()[1]
    path = label_path(sample) if what == "label" else picture_path(what, sample)  # type: ignore[arg-type]
    damage(session / path)  # type: ignore[operator]
    code, answer = verified(session, capsys)
    assert (code, set(kinds(answer))) == (EXIT_FOUND, {kind})
    assert {one["sample"] for one in answer["problems"]} == {sample}  # type: ignore[attr-defined]
    code, answer = verified(session, capsys, "--repair")
    assert code == EXIT_OK
    assert answer["moved"]["samples"] == [sample]  # type: ignore[index]
    assert verified(session, capsys)[0] == EXIT_OK
    assert len(SessionReader(session).samples()) == 2
    assert main(["dataset", "restore", "--session", str(session), sample]) == EXIT_OK
    assert verified(session, capsys)[0] == EXIT_FOUND


def test_files_without_a_label_go_to_the_quarantine(session: Path, capsys: Captured) -> None:
    sample = SessionReader(session).samples()[0]
    (session / label_path(sample)).unlink()
    (session / "rgb" / ".rgb_x.png.tmp").write_bytes(b"half")
    (session / "rgb" / "notes.txt").write_text("mine")
    code, answer = verified(session, capsys)
    assert (code, sorted(kinds(answer))) == (EXIT_FOUND, ["orphan", "orphan", "orphan", "temporary"])
    assert main(["inspect", str(session), "--repair"]) == EXIT_OK
    told = capsys.readouterr().out
    assert "4 files without a sample are in" in told
    assert len([path for path in (session / "quarantine").rglob("*") if path.is_file()]) == 4
    assert (session / "rgb" / "notes.txt").read_text() == "mine", "what is not tagmill's is left alone"
    assert verified(session, capsys)[0] == EXIT_OK


def test_nothing_is_moved_from_under_another_tagmill(session: Path, capsys: Captured) -> None:
    sample = SessionReader(session).samples()[0]
    (session / picture_path("rgb", sample)).unlink()
    with FolderLock(session):
        assert main(["inspect", str(session), "--repair"]) == EXIT_REFUSED
    assert "being written by another tagmill" in capsys.readouterr().err
    assert sample in SessionReader(session).samples()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["inspect", "nowhere"], "there is no session nowhere"),
        (["inspect", "dataset/monday", "--top", "0"], "--top must be 1 or more"),
        (["inspect", "dataset/empty"], "has no sample yet"),
        (["inspect", "dataset/monday", "--out", "file"], "can't be written"),
    ],
)
def test_mistakes_are_told(session: Path, words: list[str], told: str, capsys: Captured) -> None:
    make_session(session.parent / "empty")
    Path("file").write_text("")
    assert main(words) == EXIT_REFUSED
    assert told in capsys.readouterr().err
    assert set(places(session).values()) == {"session"}


def test_a_damaged_session_file_is_told(session: Path, capsys: Captured) -> None:
    (session / "session.json").write_text("{")
    code, answer = verified(session, capsys)
    assert (code, kinds(answer)) == (EXIT_FOUND, ["session"])
    assert main(["inspect", str(session)]) == EXIT_REFUSED
    assert "session.json is not JSON" in capsys.readouterr().err
