"""The wall clock of a stack can be set while it runs, without touching the machine's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.support.stack import ROOT

SCRIPT = """
import sys, time
from common import clock
for line in sys.stdin:
    print(round((clock.wall_ns() - time.time_ns()) / 1e9), flush=True)
"""


def test_a_file_sets_the_wall_clock_of_a_process_that_runs(tmp_path: Path) -> None:
    offset = tmp_path / "offset"
    offset.write_text("-3600".ljust(32))
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        cwd=ROOT,
        env={**os.environ, "TAGMILL_WALL_OFFSET_FILE": str(offset), "TAGMILL_WALL_OFFSET_S": "10"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process, process.stdin as ask:
        for seconds in (-3600, 120, 0):
            with offset.open("r+") as file:
                file.write(str(seconds).ljust(32))
            ask.write("now\n")
            ask.flush()
            assert int(process.stdout.readline()) == seconds + 10
