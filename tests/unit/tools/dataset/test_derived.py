"""`dataset merge`, `split`, `rename-class`: new sessions that are whole, sources that stay as they are."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from common.dataset import SESSION_FILE, SessionFile, SessionReader, picture_path, read_session
from common.dataset.bin import delete, restore
from common.dataset.derive import Taken, derive
from common.dataset.locks import FolderLock
from common.dataset.snapshot import Snapshot
from common.errors import EXIT_FOUND, EXIT_OK, EXIT_REFUSED
from common.labels import Label
from common.ledgers import CameraLedger, Ledger
from services.store.sample import write_sample
from tests.support.samples import label_for, pixels, spec
from tests.support.sessions import make_session, places
from tools.cli import main

Captured = pytest.CaptureFixture[str]
OBJECTS = {
    "box-0": {
        "type": "box",
        "size_mm": {"width": 400.0, "height": 300.0, "depth": 300.0},
        "sides": {
            side: {
                "face": side,
                "marker": number,
                "marker_size_mm": 50.0,
                "border_mm": 10.0,
                "offset_mm": [0.0, 0.0, 0.0],
                "rotation_deg": 0.0,
            }
            for number, side in enumerate(("front", "left"))
        },
    }
}
"""As session.json has it; `tests.support.samples` labels show its front."""


def ledgered(folder: Path, labels: Sequence[Label], refused: int = 4, **change: object) -> None:
    """A session whose ledger tells of these samples, and of frames that were refused."""
    make_session(folder, *labels)
    counts: dict[str, int] = {}
    for label in labels:
        counts[label.recording or ""] = counts.get(label.recording or "", 0) + 1
    recordings = {
        name: Ledger(
            spec=spec(name),
            phase="ended",
            cameras={"cam0": CameraLedger(captured=count + refused, recorded=count, refused={"no_object": refused})},
        )
        for name, count in counts.items()
    }
    file = SessionFile(
        name=folder.name,
        created_at="2026-08-30T12:00:00.000Z",
        rig={"markers": {"family": "apriltag_36h11"}, "objects": OBJECTS, "cameras": {}, **change},
        versions={},
        recordings=recordings,
    )
    (folder / SESSION_FILE).write_bytes(file.to_bytes())


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """``monday`` (three samples of rec-a, two of rec-b) and ``tuesday`` (two of rec-c)."""
    (tmp_path / "rig.yaml").write_text("dataset: {root: ./dataset, session: monday}\n")
    root = tmp_path / "dataset"
    monday = [label_for(n) for n in (1, 2, 3)] + [label_for(n, recording="rec-b") for n in (4, 5)]
    ledgered(root / "monday", monday)
    ledgered(root / "tuesday", [label_for(n, recording="rec-c") for n in (8, 9)])
    monkeypatch.chdir(tmp_path)
    return root


def whole(session: Path, capsys: Captured) -> bool:
    """Every file opens, and the ledger adds up (the labels of these tests are no projections: those may contradict)."""
    capsys.readouterr()
    assert main(["inspect", str(session), "--verify", "--json"]) in (EXIT_OK, EXIT_FOUND)
    answer = json.loads(capsys.readouterr().out)
    others = [one for one in answer["problems"] if one["kind"] != "contradiction"]
    assert others == []
    return set(places(session).values()) <= {"session"}


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_merge_has_all_samples_and_both_ledgers(root: Path, capsys: Captured) -> None:
    before = everything(root / "monday") | everything(root / "tuesday")
    assert main(["dataset", "merge", "monday", "tuesday", "--into", "week"]) == EXIT_OK
    assert "week: 7 samples in" in capsys.readouterr().out
    assert everything(root / "monday") | everything(root / "tuesday") == before
    reader = SessionReader(root / "week")
    assert len(reader.samples()) == 7
    assert {reader.label(sample).session for sample in reader.samples()} == {"week"}
    assert set(reader.session.recordings) == {"rec-a", "rec-b", "rec-c"}
    assert whole(root / "week", capsys)
    one = picture_path("rgb", reader.samples()[0])
    assert (root / "week" / one).samefile(root / "monday" / one), "pictures are linked"


def test_split_by_recording_and_merged_again_is_the_same(root: Path, capsys: Captured) -> None:
    assert main(["dataset", "split", "monday", "--by", "recording"]) == EXIT_OK
    assert len(SessionReader(root / "monday-rec-a").samples()) == 3
    assert whole(root / "monday-rec-a", capsys)
    assert main(["dataset", "merge", "monday-rec-a", "monday-rec-b", "--into", "again"]) == EXIT_OK
    assert SessionReader(root / "again").samples() == SessionReader(root / "monday").samples()
    assert read_session(root / "again").recordings == read_session(root / "monday").recordings
    assert whole(root / "again", capsys)


def test_split_of_named_samples_keeps_the_account_of_a_recording(
    root: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = SessionReader(root / "monday").samples()
    monkeypatch.setattr(sys, "stdin", io.StringIO(f"{names[0]}\n{names[4]}\n"))
    assert main(["dataset", "split", "monday", "-", "--into", "few", "--rest", "most"]) == EXIT_OK
    assert SessionReader(root / "few").samples() == (names[0], names[4])
    assert SessionReader(root / "most").samples() == names[1:4]
    assert whole(root / "few", capsys), "samples elsewhere are accounted for"
    assert whole(root / "most", capsys)
    assert main(["dataset", "merge", "few", "most", "--into", "again"]) == EXIT_OK
    assert SessionReader(root / "again").samples() == names
    assert whole(root / "again", capsys)


def test_rename_class_renames_labels_and_rig_alike(root: Path, capsys: Captured) -> None:
    assert main(["dataset", "rename-class", "monday", "front", "label side", "--into", "renamed"]) == EXIT_OK
    reader = SessionReader(root / "renamed")
    assert {side.class_name for s in reader.samples() for item in reader.label(s).objects for side in item.sides} == {
        "label side"
    }
    assert list(reader.session.rig["objects"]["box-0"]["sides"]) == ["label side", "left"]
    assert whole(root / "renamed", capsys)
    assert main(["dataset", "rename-class", "renamed", "box", "carton", "--type", "--into", "typed"]) == EXIT_OK
    typed = SessionReader(root / "typed")
    assert {item.type for sample in typed.samples() for item in typed.label(sample).objects} == {"carton"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["merge", "monday", "--into", "x"], "name two sessions or more"),
        (["merge", "monday", "dataset/monday", "--into", "x"], "name two sessions or more"),
        (["merge", "monday", "nowhere", "--into", "x"], "there is no session nowhere"),
        (["merge", "monday", "tuesday", "--into", "monday"], "there is a session monday in"),
        (["merge", "monday", "tuesday", "--into", "../x"], "'../x' can't be the name of a session"),
        (["merge", "monday", "other", "--into", "x"], "recorded with different rigs: objects.box-0.type: box -> crate"),
        (["merge", "monday", "copy", "--into", "x"], "is in two of the sessions"),
        (["split", "monday"], "say --by camera"),
        (["split", "monday", "--by", "camera", "--into", "x"], "leave --into, --rest and samples out"),
        (["split", "monday", "--into", "x"], "no sample was named"),
        (["split", "monday", "nothing", "--into", "x"], "monday has no sample nothing"),
        (["rename-class", "monday", "back", "x", "--into", "x"], "no object has the side back; there are front, left"),
        (["rename-class", "monday", "front", "left", "--into", "x"], "box-0 has a side left already"),
        (["rename-class", "monday", "front", " ", "--into", "x"], "not empty"),
        (["rename-class", "monday", "front", "x", "--object", "b", "--into", "x"], "there is no object b"),
    ],
)
def test_mistakes_are_told_and_make_nothing(root: Path, words: list[str], told: str, capsys: Captured) -> None:
    ledgered(root / "other", [label_for(20)], objects={"box-0": {**OBJECTS["box-0"], "type": "crate"}})
    ledgered(root / "copy", [label_for(1)])
    before = everything(root)
    assert main(["dataset", *words]) == EXIT_REFUSED
    assert told in capsys.readouterr().err
    assert everything(root) == before


def test_what_a_stack_has_open_is_taken_as_it_is(root: Path, capsys: Captured) -> None:
    """The store holds the lock, its recording runs, and its last word about it is older than the last sample."""
    monday = read_session(root / "monday")
    running = monday.recordings["rec-b"].model_copy(
        update={"phase": "running", "cameras": {"cam0": CameraLedger(captured=9, recorded=1, pending=3)}}
    )
    open_one = monday.model_copy(update={"recordings": {**monday.recordings, "rec-b": running}})
    (root / "monday" / SESSION_FILE).write_bytes(open_one.to_bytes())
    before = everything(root / "monday")
    with FolderLock(root / "monday"):
        for words in (
            ["merge", "tuesday", "monday", "--into", "week"],
            ["split", "monday", "--by", "recording"],
            ["rename-class", "monday", "front", "face", "--into", "renamed"],
        ):
            assert main(["dataset", *words]) == EXIT_OK
    assert everything(root / "monday") == before
    for name, samples in (("week", 7), ("monday-rec-a", 3), ("monday-rec-b", 2), ("renamed", 5)):
        assert len(SessionReader(root / name).samples()) == samples
        assert whole(root / name, capsys)
    ledger = read_session(root / "monday-rec-b").recordings["rec-b"]
    account = ledger.cameras["cam0"]
    assert (ledger.phase, account.recorded, account.dropped, account.settled) == (
        "interrupted",
        2,
        {"interrupted": 7},
        True,
    )
    assert ledger.why == "it was still running when monday-rec-b was made of monday"


def test_parts_of_different_moments_are_merged_by_the_later_account(root: Path, capsys: Captured) -> None:
    assert main(["dataset", "split", "monday", "--by", "recording"]) == EXIT_OK
    ledgered(root / "later", [label_for(n) for n in (6, 7)], refused=9)
    assert main(["dataset", "merge", "later", "monday-rec-a", "--into", "all-of-a"]) == EXIT_OK
    account = read_session(root / "all-of-a").recordings["rec-a"].cameras["cam0"]
    assert (account.recorded, account.settled) == (5, True)
    assert whole(root / "all-of-a", capsys)


def test_samples_deleted_and_stored_meanwhile_change_nothing(root: Path, capsys: Captured) -> None:
    monday = Snapshot(root / "monday")
    first, second, *_ = names = monday.samples()
    delete(root / "monday", [first, second])
    late = label_for(99, recording="rec-b")
    write_sample(root / "monday", late, {"rgb": pixels(99)[0], "depth": pixels(99)[1]}, reserve=0)
    assert derive(root / "then", [Taken(monday)]) == len(names)
    assert SessionReader(root / "then").samples() == names
    assert whole(root / "then", capsys)
    assert len(Snapshot(root / "monday").samples()) == len(names) - 1
    restore(root / "monday", [first, second])


def test_a_damaged_source_makes_nothing(root: Path, capsys: Captured) -> None:
    sample = SessionReader(root / "monday").samples()[3]
    (root / "monday" / picture_path("depth", sample)).unlink()
    assert main(["dataset", "merge", "monday", "tuesday", "--into", "week"]) == EXIT_REFUSED
    assert "'tagmill inspect monday --repair' first" in capsys.readouterr().err
    assert sorted(path.name for path in root.iterdir()) == ["monday", "tuesday"]


def test_a_kill_leaves_nothing_that_counts_and_the_next_attempt_clears_it(root: Path, capsys: Captured) -> None:
    """Killed within the last step, before the name is given."""
    script = (
        "import os, signal; from common.dataset import derive as d; from pathlib import Path\n"
        "from common.dataset.snapshot import Snapshot\n"
        "Path.rename = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"d.derive(Path({str(root / 'week')!r}), [d.Taken(Snapshot(Path({str(root / 'monday')!r})))])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=Path(__file__).parents[4], check=False)
    assert done.returncode == -9
    assert sorted(path.name for path in root.iterdir()) == [".week.part", "monday", "tuesday"]
    assert main(["dataset", "merge", "monday", "tuesday", "--into", "week"]) == EXIT_OK
    assert sorted(path.name for path in root.iterdir()) == ["monday", "tuesday", "week"]
    assert whole(root / "week", capsys)
