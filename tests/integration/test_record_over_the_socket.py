"""Journey 2: the ten lines of docs/how-to/record-over-the-socket.md, against the real stack."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from common.bus import CommandClient
from common.dataset import SessionReader
from tests.support.stack import ROOT, Stack, wait_for, write_rig
from tests.support.supervised import OBJECT

PAGE = ROOT / "docs" / "how-to" / "record-over-the-socket.md"
RIG = f"""\
dataset: {{root: ./dataset, session: journey}}
cameras:
  cam0: {{driver: synthetic, width: 640, height: 360, fps: 10}}
ring: {{slots: 8, samples: 8}}
{OBJECT}"""


def ten_lines() -> str:
    found = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found is not None
    return found[1]


def test_they_are_ten_lines_without_tagmill() -> None:
    lines = [line for line in ten_lines().splitlines() if line]
    assert len(lines) <= 10
    assert not re.search(r"tagmill|common|services|tools", ten_lines())


@pytest.mark.process
def test_ten_lines_record_five_samples_whose_files_are_there(stack: Stack, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, RIG)
    for service in ("control", "store", "label", "detect"):
        stack.start_service(service, rig)
    stack.start_service("capture", rig, "--camera", "cam0")
    with CommandClient(stack.endpoints, 30.0) as client:
        wait_for(lambda: client.request({"command": "status"})["missing"] == (), 60.0, "all services")
    script = tmp_path / "ten_lines.py"
    script.write_text(ten_lines().replace("tcp://127.0.0.1:5750", stack.endpoints.command))
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    reader = SessionReader(tmp_path / "dataset" / "journey")
    assert done.returncode == 0, done.stderr
    names = done.stdout.split()
    assert len(names) == len(set(names)) == 5
    for name in names:
        label = reader.label(name)
        reader.verify(label)
        assert label.objects
