"""What `tagmill view --save` writes, read back with Rerun's own reader."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from common.dataset import SessionReader
from tests.support.recorded import samples, write_session
from tools.cli import main

pytestmark = [pytest.mark.long, pytest.mark.loaders]


@pytest.mark.timeout(300)
def test_pictures_points_windows_and_boxes_of_every_sample(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from rerun.chunk import RrdReader

    session, file = tmp_path / "boxes", tmp_path / "boxes.rrd"
    write_session(session, samples(12))
    capsys.readouterr()
    assert main(["view", str(session), "--save", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"ok": True, "samples": 12, "file": str(file)}
    rows: Counter[str] = Counter()
    for chunk in RrdReader(file).stream():
        rows[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    reader = SessionReader(session)
    labels = [reader.label(sample) for sample in reader.samples()]
    assert rows["/cam0/points"] == sum(label.depth is not None for label in labels) == 12
    assert rows["/cam0/image"] >= 12, "a pinhole and a picture each"
    for name in ("box-1", "box-2"):
        shown = sum(item.name == name for label in labels for item in label.objects)
        assert rows[f"/cam0/objects/{name}"] >= shown > 0
        assert rows[f"/cam0/image/boxes/{name}"] >= shown


def test_a_refused_file_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = tmp_path / "boxes"
    write_session(session, samples(2))
    assert main(["view", str(session), "--save", str(tmp_path / "nowhere" / "boxes.rrd"), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "bad_out"
    assert [path.name for path in tmp_path.iterdir()] == ["boxes"]
