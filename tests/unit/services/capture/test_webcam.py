"""Runs the tests that drive OpenCV's real V4L2 backend: each process has the preloaded webcam or hasn't."""

from __future__ import annotations

import errno
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

from services.capture.cameras.webcam_v4l2 import refusal
from tests.support.v4l2.device import preloaded

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]


def test_the_webcam_driver_on_a_preloaded_device(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    conformance = HERE / "test_driver_conformance.py"
    command = [sys.executable, "-m", "pytest", str(HERE / "preloaded"), str(conformance), "-k", "preloaded or webcam"]
    command += ["-p", "no:cacheprovider", f"--basetemp={tmp_path / 'devices'}", f"--junitxml={report}"]
    done = subprocess.run(
        command, cwd=ROOT, env=preloaded(tmp_path), capture_output=True, text=True, timeout=110, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    suite = next(ET.parse(report).getroot().iter("testsuite"))
    assert suite.get("skipped") == "0"
    assert int(suite.get("tests", "0")) > 25


def test_who_uses_it_is_named(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.touch()
    script = "import sys; held = open(sys.argv[1]); print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", script, str(node)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        told = refusal(node, OSError(errno.EBUSY, "busy"))
        assert f"{node} is in use by " in told
        assert f"(process {holder.pid}); close that first" in told
        holder.communicate(timeout=20)
    assert "by another program" in refusal(node, OSError(errno.EBUSY, "busy"))
