"""`tagmill view` where it can't show anything: one clear sentence each."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.recorded import samples, write_session
from tools.cli import main


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, str]:
    capsys.readouterr()
    assert main(["view", *words, "--json"]) == 3
    error: dict[str, str] = json.loads(capsys.readouterr().out)["error"]
    return error


def test_without_rerun_it_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # as Python answers for a package that isn't there
    error = refused(capsys, str(tmp_path), "--save", str(tmp_path / "a.rrd"))
    assert error["code"] == "no_rerun"
    assert "pip install 'tagmill[view]'" in error["message"]


def test_without_a_screen_or_a_sample(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", ModuleType("rerun"))  # is there, and isn't reached
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    write_session(tmp_path / "boxes", samples(1))
    assert refused(capsys, str(tmp_path / "boxes"))["code"] == "no_screen"
    assert refused(capsys, str(tmp_path / "boxes"), "--camera", "cam7")["code"] == "no_sample"
    assert refused(capsys, str(tmp_path / "boxes"), "--every", "0")["code"] == "out_of_bounds"
    assert refused(capsys, str(tmp_path / "none"))["code"] == "unknown_session"
