"""`tagmill up` where somebody else has the port, or where shared memory is full."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from common.bus import Endpoints
from common.config import load_rig
from common.errors import EXIT_NAME_TAKEN, EXIT_NO_ANSWER
from tests.support.hygiene import Place
from tests.support.mounts import small_disk
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S
from tools.stack.running import running_stack
from tools.stack.up import write_config

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

RIG = """\
dataset: {{root: ./dataset, session: taken}}
network: {{console: {console}, command: "tcp://127.0.0.1:{port}"}}
cameras:
  cam0: {{driver: synthetic, width: 320, height: 240, fps: 10, prerendered: 4}}
ring: {{slots: 6, samples: 4}}
"""


@pytest.fixture
def port() -> Iterator[socket.socket]:
    """Another program's listening socket."""
    with closing(socket.create_server(("127.0.0.1", 0))) as held:
        yield held


@pytest.fixture
def default_prefix(place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As at a user's desk: the rig's own addresses, but a run folder and shared memory of this test's."""
    monkeypatch.setenv("TAGMILL_PREFIX", "tagmill")
    memory = tmp_path / "memory"
    memory.mkdir()
    monkeypatch.setenv("TAGMILL_SHM_DIR", str(memory))


def written(folder: Path, port: socket.socket, console: str = "null") -> Path:
    rig = folder / "rig.yaml"
    rig.write_text(RIG.format(port=port.getsockname()[1], console=console))
    return rig


def tagmill(*words: str, seconds: float = 60) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tools", *words], capture_output=True, text=True, timeout=seconds, check=False
    )


@pytest.mark.usefixtures("default_prefix")
@pytest.mark.parametrize("key", ["command", "console"])
def test_up_says_at_once_that_a_port_is_taken(key: str, port: socket.socket, tmp_path: Path) -> None:
    number = port.getsockname()[1]
    rig = written(tmp_path, port, f"'http://127.0.0.1:{number}'")
    if key == "console":
        rig.write_text(rig.read_text().replace(f', command: "tcp://127.0.0.1:{number}"', ", command: ipc:///dev/null"))
    done = tagmill("up", "--rig", str(rig))
    assert done.returncode == EXIT_NAME_TAKEN, done
    assert f"127.0.0.1:{number} is in use by another program" in done.stderr
    assert f"choose another network.{key} in the rig file" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(Endpoints.of(load_rig(rig).config.network).run_dir.iterdir())


@pytest.mark.usefixtures("default_prefix")
def test_status_tells_what_keeps_control_and_control_takes_the_port_when_it_is_free(
    port: socket.socket, tmp_path: Path
) -> None:
    """Started from a supervisor configuration, which nothing checks before."""
    rig = written(tmp_path, port)
    loaded = load_rig(rig)
    endpoints = Endpoints.of(loaded.config.network)
    endpoints.prepare()
    config = write_config(loaded, endpoints)
    with (tmp_path / "supervisord.log").open("wb") as sink:
        stack = subprocess.Popen(
            [sys.executable, "-m", "supervisor.supervisord", "-n", "-c", str(config)], stdout=sink, stderr=sink
        )
    try:

        def told() -> str | None:
            done = tagmill("status", "--rig", str(rig))
            assert done.returncode == EXIT_NO_ANSWER, done
            return done.stderr if "in use by another program" in done.stderr else None

        words = wait_for(told, DEADLINE_S, "status to tell why control does not answer")
        assert f"its supervisord runs (process {stack.pid})" in words
        port.close()

        def answers() -> bool:
            return tagmill("status", "--rig", str(rig)).returncode == 0

        wait_for(answers, DEADLINE_S, "control to take the port")
    finally:
        tagmill("down", "--rig", str(rig), seconds=DEADLINE_S)
        stack.wait(DEADLINE_S)


def test_full_shared_memory_is_told_by_status_and_healed_by_room(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.format(port=5750, console="null"))

    def status() -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(tagmill("status", "--json", "--rig", str(rig)).stdout)
        return answer

    with small_disk(tmp_path / "memory", 3.0) as memory:
        monkeypatch.setenv("TAGMILL_SHM_DIR", str(memory))
        # All but 100 KB: neither the camera's ring (2 MB) nor a sample ring fits.
        filler = memory / "somebody-elses"
        filler.write_bytes(bytes(int(os.statvfs(memory).f_bavail * os.statvfs(memory).f_frsize) - 100_000))
        with running_stack(rig, tmp_path / "stack.log"):

            def said() -> str | None:
                camera = (status().get("cameras") or {}).get("cam0") or {}
                text = str(camera.get("last_error") or "")
                return text if "--shm-size" in text else None

            words = wait_for(said, DEADLINE_S, "status to tell that shared memory is full")
            assert "shared memory is full" in words
            filler.unlink()
            wait_for(lambda: status()["cameras"]["cam0"]["phase"] == "streaming", DEADLINE_S, "the camera to stream")
