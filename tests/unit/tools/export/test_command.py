"""What a person types: classes, filters, pictures, going on after a stop, and a sentence for each mistake."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.recorded import Painter, incomplete, label_of, make_box, moving, samples, write_session
from tests.unit.tools.export.conftest import Export, tree
from tools.cli import main
from tools.export import write as writing
from tools.export.pictures import Change


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["yolo5", "{s}"], "unknown format 'yolo5'; did you mean 'yolo'?"),
        (["yolo", "{t}/nowhere"], "there is no session nowhere in"),
        (["yolo", "{t}/empty"], "there is no sample in"),
        (["yolo", "{s}", "{s}"], "is named twice"),
        (["yolo", "{s}", "--camera", "cam7"], "the sessions have no camera 'cam7'; they have cam0"),
        (["yolo", "{s}", "--object", "box-7"], "the sessions have no object 'box-7'; they have box-1, box-2"),
        (["yolo", "{s}", "--size", "640"], "--size '640' is no size such as 640x480"),
        (["yolo", "{s}", "--letterbox"], "--letterbox needs --size"),
        (["yolo", "{s}", "--val", "0.7", "--test", "0.4"], "together below 1"),
        (
            ["yolo", "{s}", "--classes", "sides"],
            "--classes is 'side', 'type' or a YAML file; sides: there is no such file",
        ),
        (["bop", "{s}", "--classes", "side"], "bop describes whole objects"),
        (["kitti", "{s}", "--pictures", "jpg"], "this format takes png pictures only, not jpg"),
        (["yolo", "{s}", "--max-distance-mm", "10"], "none of 12 samples is left: 12 too near or too far"),
        (["yolo", "{s}", "--split", "session"], "a split by session needs at least 2 of them, there is 1"),
        (["yolo", "{s}", "{t}/other"], "can't be one training set: markers.family"),
        (["yolo", "{s}", "{t}/larger"], "can't be one training set: objects.box-1.size_mm.width: 400 -> 500"),
    ],
)
def test_each_mistake_has_its_sentence_and_nothing_is_written(
    session12: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    write_session(tmp_path / "empty", [])
    row = label_of(500, moving(1)), {"rgb": Painter().paint(moving(1))["rgb"]}
    write_session(tmp_path / "other", [row], markers="apriltag_25h9")
    write_session(tmp_path / "larger", [row], (make_box("box-1", 0, size=(500.0, 300.0, 300.0)), make_box("box-2", 9)))
    typed = [word.format(s=session12, t=tmp_path) for word in words]
    assert main(["export", *typed, "--out", str(tmp_path / "out")]) == 3
    told = capsys.readouterr().err
    assert sentence in " ".join(told.split())
    assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


def test_a_session_is_named_as_everywhere_else(
    session12: Path, tmp_path: Path, export: Export, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.yaml").write_text(f"dataset: {{root: {session12.parent}}}\n")
    monkeypatch.chdir(tmp_path)
    assert sum(export("yolo", session12.name, "--no-check", out=tmp_path / "out")["samples"].values()) == 12


def test_a_folder_of_somebody_elses_is_not_touched(
    session12: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("x")
    (tmp_path / "file").write_text("x")
    before = tree(tmp_path)
    assert main(["export", "yolo", str(session12), "--out", str(tmp_path / "thesis")]) == 3
    assert "is not empty and no export of tagmill's" in capsys.readouterr().err
    assert main(["export", "yolo", str(session12), "--out", str(tmp_path / "file")]) == 3
    assert "is a file; --out names a folder" in capsys.readouterr().err
    assert tree(tmp_path) == before


def test_too_small_a_disk_is_told_before_anything_is_written(
    session12: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "RESERVE_BYTES", 10**18)
    assert main(["export", "yolo", str(session12), "--copy", "--out", str(tmp_path / "out")]) == 3
    assert "nothing was written: free some, or choose another folder" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_damaged_picture_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = write_session(tmp_path / "s", samples(6, depth=False))
    picture = tmp_path / "s" / "rgb" / f"rgb_{names[3]}.png"
    picture.write_bytes(picture.read_bytes()[:20])
    words = [
        "export",
        "yolo",
        str(tmp_path / "s"),
        "--split",
        "none",
        "--size",
        "64x48",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 3
    assert f"rgb_{names[3]}.png is no picture that can be read" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out" / "data.yaml").exists()


@pytest.mark.parametrize("stop", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_run_that_is_stopped_leaves_whole_files_and_is_gone_on_with(
    session12: Path, tmp_path: Path, export: Export, monkeypatch: pytest.MonkeyPatch, stop: BaseException
) -> None:
    made: list[Path] = []
    colour: Callable[[Change, Path], bytes] = Change.colour

    def stopping(self: Change, path: Path) -> bytes:
        made.append(path)
        if len(made) == 6:
            raise stop
        return colour(self, path)

    monkeypatch.setattr(Change, "colour", stopping)
    words = ["export", "yolo", str(session12), "--size", "64x48", "--workers", "1", "--out", str(tmp_path / "out")]
    assert main(words) == (130 if stop is KeyboardInterrupt else 3)
    out = tmp_path / "out"
    assert not (out / "data.yaml").exists()
    for path in out.rglob("*"):
        assert not path.name.endswith(".tmp")
        if path.suffix == ".png":
            assert cv2.imread(str(path)).shape == (48, 64, 3)
    monkeypatch.setattr(Change, "colour", colour)
    told = export("yolo", session12, "--size", "64x48", out=out)
    assert told["checks"]["wrong"] == []
    assert told["files"]["kept"] >= 5


def test_other_options_take_away_what_is_the_exports_no_more(session12: Path, tmp_path: Path, export: Export) -> None:
    out = tmp_path / "out"
    export("yolo", session12, out=out)
    (out / "labels.cache").write_text("a trainer's own")
    told = export("yolo", session12, "--pictures", "jpg", "--split", "none", out=out)
    assert told["checks"]["wrong"] == []
    assert not list(out.rglob("*.png"))
    assert not (out / "images" / "val").exists()
    assert len(list((out / "images" / "train").iterdir())) == 12
    assert (out / "labels.cache").exists()
    fresh = tmp_path / "fresh"
    export("yolo", session12, "--pictures", "jpg", "--split", "none", out=fresh)
    same = {path: (size,) for path, (_, size, _) in tree(out).items() if path != "labels.cache"}
    assert same == {path: (size,) for path, (_, size, _) in tree(fresh).items()}


def test_unchanged_pictures_are_links_and_copies_only_when_asked(
    session12: Path, tmp_path: Path, export: Export
) -> None:
    linked = export("yolo", session12, out=tmp_path / "a")
    copied = export("yolo", session12, "--copy", out=tmp_path / "b")
    assert (linked["files"]["linked"], copied["files"]["linked"]) == (12, 0)
    assert linked["need_bytes"] < 10_000 < copied["need_bytes"]
    for path in (tmp_path / "a" / "images").rglob("*.png"):
        source = session12 / "rgb" / f"rgb_{path.name}"
        assert os.path.samefile(path, source)  # noqa: PTH121
        other = next((tmp_path / "b").rglob(path.name))
        assert other.read_bytes() == source.read_bytes()
        assert not os.path.samefile(other, source)  # noqa: PTH121


def test_a_mapping_names_classes_the_more_exact_key_wins(session60: Path, tmp_path: Path, export: Export) -> None:
    (tmp_path / "map.yaml").write_text("box-1/front: Etikett vorn\nbox: Kiste\ncarton: null\n")
    told = export("yolo", session60, "--classes", tmp_path / "map.yaml", out=tmp_path / "out")
    assert set(told["classes"]) == {"Etikett vorn", "Kiste"}
    assert all(told["classes"].values())
    assert told["checks"]["wrong"] == []
    (tmp_path / "map.yaml").write_text("box-9: x\n")
    told = export("yolo", session60, "--classes", tmp_path / "map.yaml", out=tmp_path / "out", code=3)
    assert "the sessions have no 'box-9'" in told["error"]["message"]


def test_all_sides_gives_each_visible_side_its_own_window(session60: Path, tmp_path: Path, export: Export) -> None:
    one = export("yolo", session60, "--split", "none", out=tmp_path / "a")
    each = export("yolo-segment", session60, "--split", "none", "--all-sides", out=tmp_path / "b")
    assert sum(each["classes"].values()) > 1.3 * sum(one["classes"].values())
    assert each["checks"]["wrong"] == []


def test_incomplete_samples_and_limits_are_left_out_and_said(tmp_path: Path, export: Export) -> None:
    rows = list(samples(10, depth=False))
    rows[2] = (incomplete(rows[2][0]), rows[2][1])
    blurred = cv2.GaussianBlur(rows[5][1]["rgb"], (0, 0), 6)
    rows[5] = (rows[5][0], {"rgb": np.asarray(blurred)})
    write_session(tmp_path / "s", rows)
    told = export("yolo", tmp_path / "s", "--split", "none", out=tmp_path / "out")
    assert (told["left_out"], told["samples"]) == ({"incomplete": 1}, {"train": 9})
    told = export("yolo", tmp_path / "s", "--split", "none", "--incomplete", out=tmp_path / "out")
    assert told["samples"] == {"train": 10}
    names = {
        row["sample"] for row in json.loads((tmp_path / "out" / "tagmill-export.json").read_text())["samples"].values()
    }
    assert len(names) == 10
    told = export("yolo", tmp_path / "s", "--split", "none", "--max-blur", "0.5", out=tmp_path / "out")
    assert told["left_out"] == {"incomplete": 1, "blur": 1}
    assert rows[5][0].sample not in (tmp_path / "out" / "tagmill-export.json").read_text()


def test_a_changed_label_is_found_by_the_check(session12: Path, tmp_path: Path, export: Export) -> None:
    export("yolo", session12, "--split", "none", out=tmp_path / "out")
    path = next(path for path in (tmp_path / "out" / "labels" / "train").iterdir() if path.stat().st_size)
    values = path.read_text().split()
    values[1] = f"{float(values[1]) + (-0.05 if float(values[1]) > 0.5 else 0.05):.6f}"
    text = " ".join(values[:5])
    path.write_text(text.ljust(path.stat().st_size - 1) + "\n")
    told = export("yolo", session12, "--split", "none", out=tmp_path / "out", code=3)
    assert told["checks"]["wrong"]
