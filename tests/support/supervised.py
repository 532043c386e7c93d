"""A whole stack under a real supervisord, for tests that kill, stop and plug in while it runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from common.bus import CommandClient, Endpoints, Poller
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from common.errors import TagmillError
from tests.support.rigs import box
from tests.support.stack import ROOT, wait_for
from tools.stack.programs import SOCKET_FILE
from tools.stack.running import running_stack, wait_ready
from tools.stack.supervisor import Supervisor

DEADLINE_S = 90.0
"""How long a test waits for a process to come back or a stack to be ready, on a machine that is busy."""

OBJECT = (
    """\
objects:
"""
    + box()
    + """\
pose: {ambiguous: keep}
record: {incomplete: keep}
"""
)
"""A box that any frame of the synthetic camera can be recorded of."""

NO_PAGE = OBJECT + "network: {console: null}\n"
"""The same without the operator's page: one process less to start and to end."""

SERVICES = {"control": "control", "store": "store", "label": "label.0", "detect": "detect.0"}


def service_of(program: str) -> str:
    """The service id of a program of the supervisor (one worker of each kind)."""
    return SERVICES.get(program) or program.replace("capture-", "capture.")


class SupervisedStack:
    """A running stack: its supervisor, its command socket, its processes."""

    def __init__(self, supervisor: Path, client: CommandClient) -> None:
        self.client = client
        self._supervisor = Supervisor(supervisor)

    def status(self) -> dict[str, Any]:
        """The answer to `status`; patient with a control that is restarting."""

        def ask() -> dict[str, Any] | None:
            try:
                return self.client.request({"command": "status"}, timeout_s=3.0)
            except TagmillError:
                return None

        return wait_for(ask, DEADLINE_S, "an answer to status")

    def ask(self, **request: Any) -> dict[str, Any]:
        """Any command, with time enough for a busy machine."""
        return self.client.request(request, timeout_s=DEADLINE_S)

    def wait_ready(self, *cameras: str) -> dict[str, Any]:
        """Until the roll-call is complete and the cameras stream."""
        return wait_ready(self.client, cameras, DEADLINE_S)

    def pids(self) -> dict[str, int]:
        """The supervisor's programs and their processes (0: none)."""
        return {one.name: one.pid for one in self._supervisor.processes()}

    def states(self) -> dict[str, str]:
        """The supervisor's word for each program."""
        return {one.name: one.state for one in self._supervisor.processes()}

    def wait_running(self) -> None:
        """Until the supervisor calls every program RUNNING."""
        wait_for(lambda: set(self.states().values()) == {"RUNNING"}, DEADLINE_S, "every program to be RUNNING")

    def workers(self, program: str) -> list[psutil.Process]:
        """The worker processes of a service (not multiprocessing's own helpers)."""
        children = psutil.Process(self.pids()[program]).children()
        return [child for child in children if "spawn_main" in " ".join(child.cmdline())]

    def kill(self, program: str) -> int:
        """kill -9 a service; the pid that it had."""
        pid = self.pids()[program]
        os.kill(pid, signal.SIGKILL)
        return pid

    def wait_back(self, program: str, killed: int) -> None:
        """Until the killed service is in the roll-call again, as another process and running."""
        service = service_of(program)

        def back() -> bool:
            seen = self.status()["services"].get(service)
            return bool(seen and seen["pid"] != killed and seen["alive"] and seen["phase"] == "running")

        wait_for(back, DEADLINE_S, f"{program} to come back after kill -9")


@contextmanager
def supervised(rig: Path, *cameras: str, **environment: str) -> Iterator[SupervisedStack]:
    """`tagmill up` with ``rig``, ready; `tagmill down` after the block. Log: ``stack.log`` beside the rig."""
    endpoints = Endpoints.of(NetworkConfig())
    log = rig.parent / "stack.log"
    try:
        with running_stack(rig, log, environment), CommandClient(endpoints, DEADLINE_S) as client:
            wait_ready(client, cameras, DEADLINE_S)
            yield SupervisedStack(endpoints.run_dir / SOCKET_FILE, client)
    except BaseException:
        print(logs(endpoints.run_dir / "log", log))
        raise


def run_module(
    *words: str, timeout_s: float = DEADLINE_S, env: dict[str, str] | None = None
) -> tuple[int, subprocess.CompletedProcess[str]]:
    """``python -m WORDS`` to its end, killed at the deadline; its pid (part of its stack's prefix) and what it said."""
    command = [sys.executable, "-m", *words]
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, cwd=ROOT, env=env, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True
    )
    try:
        said, complained = process.communicate(timeout=timeout_s)
    except BaseException:
        process.kill()
        process.communicate()
        raise
    return process.pid, subprocess.CompletedProcess(command, process.returncode, said, complained)


def failed(test: pytest.Item) -> bool:
    """Whether a test has failed, for the fixtures that show its logs."""
    report = getattr(test, "call_report", None)
    return report is None or bool(report.failed)


def logs(folder: Path, *more: Path) -> str:
    """The ends of a stack's logs, for the report of a failed test."""
    paths = [*more, *sorted(folder.glob("*.log"))]
    return "\n".join(f"--- {path.name}\n{path.read_text(errors='replace')[-5000:]}" for path in paths)


def recorded(session: Path) -> int:
    """How many samples there are on the disk; 0 before there is a session."""
    return len(SessionReader(session).samples()) if session.is_dir() else 0


def wait_for_samples(session: Path, more: int) -> None:
    """Until ``more`` further samples are on the disk."""
    goal = recorded(session) + more
    pause = Poller()

    def there() -> bool:
        pause.wait(0.05)
        return recorded(session) >= goal

    wait_for(there, DEADLINE_S, f"{more} further samples in {session}")


def check_session(session: Path) -> None:
    """Every sample of a session is complete, and there is no other file: nothing torn, nothing temporary."""
    reader = SessionReader(session)
    expected = {"session.json"} | {name for name in ("records.jsonl",) if (session / name).exists()}
    for sample in reader.samples():
        label = reader.label(sample)
        reader.verify(label)
        assert reader.colour(label).shape == (label.camera.height, label.camera.width, 3)
        assert label.files is not None
        named = (label.files.rgb, label.files.depth, label.files.original)
        expected |= {file.path for file in named if file is not None} | {f"label/label_{sample}.json"}
    assert {str(path.relative_to(session)) for path in session.rglob("*") if path.is_file()} == expected
