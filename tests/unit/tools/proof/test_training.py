from __future__ import annotations

from pathlib import Path

import pytest

from tools.proof.record import VARIANTS
from tools.proof.run import main
from tools.proof.training import interpreter


def test_without_an_environment_it_says_what_makes_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(tmp_path / "out"), "--trainer", str(tmp_path / "none" / "python")]) == 3
    assert "`make proof` makes it" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "out").exists()


def test_an_environment_without_the_trainer_is_named(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho \"ModuleNotFoundError: No module named 'libreyolo'\" >&2\nexit 1\n")
    python.chmod(0o755)
    with pytest.raises(Exception, match="No module named 'libreyolo'; `make proof`"):
        interpreter(python)


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("the only copy")
    assert main(["--out", str(tmp_path)]) == 2
    assert "holds something else" in " ".join(capsys.readouterr().out.split())
    assert (tmp_path / "thesis.tex").exists()


def test_the_sets_are_those_that_are_compared() -> None:
    assert VARIANTS == ("marker-free", "erased", "raw")
