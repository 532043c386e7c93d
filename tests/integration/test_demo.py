"""What a newcomer types first: the demo, and `tagmill --help`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from common.dataset import SessionReader
from tests.support.hygiene import processes_of
from tests.support.stack import ROOT
from tests.support.supervised import check_session, run_module
from tools.cli import SUB_COMMANDS, main

SAMPLES = 24
TOO_SLOW = "is the machine busy otherwise?"


@pytest.mark.process
@pytest.mark.long
@pytest.mark.timeout(400)
def test_the_demo_records_compares_and_draws(tmp_path: Path) -> None:
    out = tmp_path / "out"
    pid, done = run_module("tools.demo", "--out", str(out), timeout_s=380)
    # On a machine that is busy with other things the demo rightly ends by saying so; all else must be true even then.
    assert done.returncode == 0 or TOO_SLOW in done.stdout.splitlines()[-1], done.stdout + done.stderr
    session = out / "dataset" / "demo"
    reader = SessionReader(session)
    samples = reader.samples()
    assert len(samples) == SAMPLES
    cameras = [reader.label(name).camera.name for name in samples]
    assert set(cameras) == {"cam0", "cam1"}
    assert all(reader.label(name).objects for name in samples)
    assert all(reader.original(name) is not None and reader.depth(name) is not None for name in samples)
    check_session(session)
    sheet = cv2.imread(str(out / "contact-sheet.png"))
    assert sheet is not None
    assert sheet.std() > 10  # pictures, not a plain page
    assert str(session) in done.stdout.replace("\n", "")
    assert processes_of(f"demo-{pid}") == {}
    assert list(Path("/dev/shm").glob(f"tagmill-demo-{pid}-*")) == []


def test_the_console_script_shows_its_commands() -> None:
    script = Path(sys.executable).with_name("tagmill")
    if not script.exists():
        pytest.skip("the project is not installed beside this interpreter; `make setup` does that")
    done = subprocess.run([script, "--help"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0
    for command in SUB_COMMANDS:
        assert f"    {command.name} " in done.stdout


@pytest.mark.parametrize("command", [row.name for row in SUB_COMMANDS])
def test_every_sub_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f" {command} " in capsys.readouterr().out.splitlines()[0]


def test_make_lists_its_targets() -> None:
    done = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0
    for target in ("setup", "demo", "run", "test", "lint", "bench", "docs"):
        assert any(line.startswith(f"{target} ") for line in done.stdout.splitlines()), target
