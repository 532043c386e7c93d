"""A process that died in its camera's driver: the next one knows, tells and waits."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from common import log
from common.errors import CameraError
from services.capture.cameras.base import Camera
from services.capture.last_life import STALE_S, LastLife

ROOT = Path(__file__).resolve().parents[4]
CAMERA = cast("Camera", SimpleNamespace(grab=None))
LIFE = """\
import ctypes, os, signal, sys
from pathlib import Path
from common import log
from services.capture.last_life import LastLife

life = LastLife(Path(sys.argv[1]), "cam0", "acme", log.get())

def connect():
    {connect}

camera = None
for attempt in range(2):  # the first call may only tell of the death before
    try:
        camera = life.guard(connect)()
        break
    except Exception as error:
        print(error)
{then}
life.end()
"""
CRASH = "ctypes.string_at(0)"


@pytest.fixture
def note(tmp_path: Path) -> Path:
    return tmp_path / "capture.cam0.life"


def live(note: Path, connect: str, then: str = "") -> int:
    """One life of a process whose driver does ``connect``, then ``then``; its return code."""
    script = LIFE.format(connect=connect, then=then)
    ended = subprocess.run([sys.executable, "-c", script, str(note)], cwd=ROOT, timeout=60, check=False)
    return ended.returncode


def next_life(note: Path) -> LastLife:
    return LastLife(note, "cam0", "acme", log.get())


def test_a_crash_while_opening_is_told_once_with_its_signal_and_line(note: Path) -> None:
    assert live(note, CRASH) == -signal.SIGSEGV
    life = next_life(note)
    assert life.died is not None
    assert (life.died.signal, life.died.opening, life.died.count) == ("SIGSEGV", True, 1)
    opened = life.guard(lambda: CAMERA)
    told = r"^cam0: the process died by SIGSEGV while opening the camera \(acme\) at .*: the driver's library crashed"
    with pytest.raises(CameraError, match=told):
        opened()
    assert opened() is CAMERA
    life.end()
    assert not note.exists()


def test_deaths_in_a_row_are_counted_until_the_camera_opens(note: Path) -> None:
    for count in (1, 2, 3):
        assert live(note, CRASH) == -signal.SIGSEGV
        life = next_life(note)
        assert life.died is not None
        assert life.died.count == count
        assert ("times in a row" in life.died.sentence("cam0", "acme")) == (count > 1)
    assert live(note, "return object()", "os.kill(os.getpid(), signal.SIGKILL)") == -signal.SIGKILL
    assert next_life(note).died is None, "killed in its normal course: nothing to fear"


@pytest.mark.parametrize(
    ("death", "told"),
    [
        ("os.abort()", "SIGABRT"),
        ("os.kill(os.getpid(), signal.SIGBUS)", "SIGBUS"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL"),
    ],
)
def test_other_ways_to_die_have_their_names(note: Path, death: str, told: str) -> None:
    live(note, death)
    died = next_life(note).died
    assert died is not None
    assert (died.signal, died.opening) == (told, True)


def test_a_crash_of_an_open_camera_is_told_as_that(note: Path) -> None:
    assert live(note, "return object()", CRASH) == -signal.SIGSEGV
    died = next_life(note).died
    assert died is not None
    assert not died.opening
    assert "while the camera was open (acme) at " in died.sentence("cam0", "acme")


def test_a_driver_that_refuses_or_a_clean_end_leaves_nothing_to_tell(note: Path) -> None:
    assert live(note, "raise RuntimeError('no camera')") == 0
    assert not note.exists()
    assert live(note, "raise RuntimeError('no camera')", "os.kill(os.getpid(), signal.SIGKILL)") == -signal.SIGKILL
    assert next_life(note).died is None


@pytest.mark.parametrize("text", ["", "garbage", "[]\n", '{"doing": "opening"}\n', "\xff\n"])
def test_a_damaged_note_is_none(note: Path, text: str) -> None:
    note.write_text(text, encoding="latin-1")
    assert next_life(note).died is None


def test_a_note_of_an_earlier_run_is_none(note: Path) -> None:
    live(note, CRASH)
    long_ago = time.time() - STALE_S - 60
    os.utime(note, (long_ago, long_ago))
    assert next_life(note).died is None


def test_no_core_is_written_while_a_driver_opens(note: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_CORE)
    seen: list[Any] = []

    def connect() -> Camera:
        seen.append(resource.getrlimit(resource.RLIMIT_CORE)[0])
        return CAMERA

    life = next_life(note)
    life.guard(connect)()
    life.end()
    life.end()
    assert seen == [0]
    assert resource.getrlimit(resource.RLIMIT_CORE) == before
