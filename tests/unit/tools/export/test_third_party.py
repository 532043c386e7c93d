"""A format of somebody else's package: it appears beside the built-in ones, and is checked like them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.third_party import install
from tests.unit.tools.export.conftest import Export
from tools.cli import main
from tools.export.registry import BUILT_IN, ENTRY_POINTS, known_formats

MODULE = """
import numpy as np
from tools.export.model import ReadTarget, Traits, Written, text_file
from tools.export.formats.parts import picture_file

class Lines:
    traits = Traits(rounding_px=0.001)

    def shot(self, shot, export):
        file = picture_file(shot, f"pictures/{shot.stem}.{shot.change.extension}")
        rows = [(t.class_name, t.window.x_min, t.window.y_min, t.window.x_max, t.window.y_max) for t in shot.targets]
        return Written((file,), [" ".join(map(str, (shot.stem, *row))) for row in rows])

    def index(self, export, told):
        return [text_file("all.txt", "".join(line + "\\n" for lines in told for line in lines))]

    def read(self, folder, export):
        rows = [line.split() for line in (folder / "all.txt").read_text().splitlines()]
        for shot in export.shots:
            mine = [row for row in rows if row[0] == shot.stem]
            yield shot, [ReadTarget(row[1], window=np.array(row[2:], dtype=float)) for row in mine]

    def notes(self, export):
        return ["every number is where it belongs"]
"""


def test_a_format_comes_from_an_installed_package(
    session12: Path,
    tmp_path: Path,
    export: Export,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.syspath_prepend(install(tmp_path / "site", "lines", MODULE, "Lines", ENTRY_POINTS))
    monkeypatch.syspath_prepend(install(tmp_path / "other", "broken", "", "Nothing", ENTRY_POINTS))
    assert known_formats() == (*BUILT_IN, "broken", "lines")
    told = export("lines", session12, out=tmp_path / "out")
    assert len((tmp_path / "out" / "all.txt").read_text().splitlines()) == sum(told["classes"].values())
    assert told["checks"]["wrong"] == []
    assert any("against the label files" in line for line in told["checks"]["right"])
    assert "no official loader is known for lines" in told["checks"]["not_checked"]
    assert main(["export", "broken", str(session12), "--out", str(tmp_path / "x")]) == 78
    assert "reinstall the package broken-package" in " ".join(capsys.readouterr().err.split())
