"""The ring between real processes: never torn, never held up, nothing left behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from common.errors import FrameLostError
from common.frames import FrameReader, segment_name, shm_folder, sweep
from tests.support.hygiene import Place
from tests.support.stack import wait_for

pytestmark = pytest.mark.process
ROOT = Path(__file__).resolve().parents[4]
READS = 1500


class Actor:
    """One process of ring_process.py."""

    def __init__(self, role: str, *arguments: str) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "tests.unit.common.frames.ring_process", role, *arguments],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def hear(self) -> dict[str, Any]:
        """The next line it says; the test's own timeout is the deadline."""
        assert self.popen.stdout is not None
        line = self.popen.stdout.readline()
        assert line, f"it ended without a word (exit {self.popen.wait(10)})"
        return json.loads(line)

    def end(self) -> None:
        if self.popen.stdin is not None and not self.popen.stdin.closed:
            with contextlib.suppress(BrokenPipeError):
                self.popen.stdin.close()
        self.popen.wait(20)

    def kill(self) -> None:
        self.popen.kill()
        self.popen.wait(20)


@pytest.fixture
def actors() -> Iterator[Callable[..., Actor]]:
    started: list[Actor] = []

    def start(role: str, *arguments: str) -> Actor:
        started.append(Actor(role, *arguments))
        return started[-1]

    yield start
    for actor in started:
        if actor.popen.poll() is None:
            actor.popen.send_signal(signal.SIGCONT)
            actor.kill()
        for pipe in (actor.popen.stdin, actor.popen.stdout):
            if pipe is not None and not pipe.closed:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()


@pytest.fixture
def writer(actors: Callable[..., Actor], place: Place) -> Iterator[tuple[Actor, str]]:
    name = segment_name(place.prefix, "cam0", "00000001")
    actor = actors("write", name)
    assert actor.hear()["ready"]
    yield actor, name
    if actor.popen.poll() is None:
        actor.end()
    sweep(place.prefix)


def goes_on(ring: FrameReader, frames: int = 500) -> bool:
    """Whether the writer gets that many frames further within the deadline."""
    target = ring.newest() + frames
    return wait_for(lambda: ring.newest() >= target, 30.0, "the writer to go on")


def test_no_accepted_frame_is_torn(writer: tuple[Actor, str], actors: Callable[..., Actor]) -> None:
    _, name = writer
    readers = [actors("read", name, str(READS)) for _ in range(3)]
    for reader in readers:
        result = reader.hear()
        assert result["torn"] == 0, result
        assert result["accepted"] == READS, result
    # The control: without the two numbers the same frames do come torn, so the readers above could have met one.
    assert actors("read-unguarded", name).hear()["torn"] == 1


def test_stopped_and_killed_readers_hold_nobody_up(writer: tuple[Actor, str], actors: Callable[..., Actor]) -> None:
    _, name = writer
    stopped, killed = actors("hold", name), actors("hold", name)
    with FrameReader(name) as ring:
        assert stopped.hear()["inside"]
        assert killed.hear()["inside"]
        stopped.popen.send_signal(signal.SIGSTOP)
        killed.kill()
        assert goes_on(ring)
        result = actors("read", name, "200").hear()
        assert (result["torn"], result["accepted"]) == (0, 200)
        stopped.popen.send_signal(signal.SIGCONT)
        assert stopped.popen.stdin is not None
        stopped.popen.stdin.close()
        assert stopped.hear()["outcome"] == "lost"


def test_the_exit_of_a_reader_destroys_nothing(writer: tuple[Actor, str], actors: Callable[..., Actor]) -> None:
    _, name = writer
    reader = actors("read", name, "10")
    assert reader.hear()["accepted"] == 10
    reader.end()
    assert (shm_folder() / name).exists()
    with FrameReader(name) as again:
        assert goes_on(again)


def test_a_killed_writers_segment_is_swept_a_live_ones_not(
    writer: tuple[Actor, str], actors: Callable[..., Actor], place: Place
) -> None:
    actor, name = writer
    other = segment_name(place.prefix, "cam1", "00000002")
    living = actors("write", other)
    assert living.hear()["ready"]
    with FrameReader(name) as ring:
        assert sweep(place.prefix) == []
        assert goes_on(ring, 10)
        actor.kill()
        assert sweep(place.prefix) == [name]
        assert not (shm_folder() / name).exists()
        assert (shm_folder() / other).exists()
        assert ring.newest() > 0, "what is mapped stays readable"
    with pytest.raises(FrameLostError, match="gone"):
        FrameReader(name)
    living.end()


def test_a_writer_that_ends_by_itself_leaves_nothing(writer: tuple[Actor, str]) -> None:
    actor, name = writer
    with FrameReader(name) as ring:
        assert goes_on(ring, 1)
    actor.end()
    assert actor.hear()["written"] > 0
    assert not (shm_folder() / name).exists()


FULL = """
import sys
from common.errors import NoSpaceError
from common.frames import FrameWriter, SampleRing, segment_name, shm_folder
held = []
try:
    for ring in range(100):
        held.append(FrameWriter(segment_name("full", f"cam{ring}", "00000003"), 320, 240, True, 4))
except NoSpaceError as error:
    print(len(held), len(list(shm_folder().iterdir())), error.message)
for writer in held:
    writer.write(None, fill=lambda bgr, depth: bgr.fill(1))
    writer.close()
"""


def run_python(script: str, *before: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*before, sys.executable, "-c", script],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_a_full_tmpfs_is_a_clear_error(tmp_path: Path) -> None:
    mount = f'mount -t tmpfs -o size=8m none {tmp_path} && exec "$0" "$@"'
    namespace = ("unshare", "--mount", "--map-root-user", "sh", "-c", mount)
    if subprocess.run([*namespace, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no tmpfs can be mounted here (unshare --mount --map-root-user)")
    found = run_python(FULL, *namespace, TAGMILL_SHM_DIR=str(tmp_path))
    assert found.returncode == 0, found.stderr
    # A ring of 4 slots 320x240 with depth is 1.5 MB: five fit into 8 MB, the sixth is refused and leaves no file.
    assert found.stdout.startswith("5 5 shared memory is full: ")
    for told in ("needs 1.5 MB", "of 8.0 MB are free", "--shm-size=64m"):
        assert told in found.stdout


def test_memory_that_ends_while_it_is_allocated_is_the_same_error(tmp_path: Path) -> None:
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))\n" + FULL
    found = run_python(limited, TAGMILL_SHM_DIR=str(tmp_path))
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith("0 0 shared memory is full: "), found.stdout
