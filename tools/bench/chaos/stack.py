"""The stack under fire: started, stopped, and its processes found while they come and go."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

import psutil

from common.bus import CommandClient, Endpoints, Poller
from common.clock import monotonic_ns
from common.config import load_rig
from common.errors import TagmillError
from tools.bench.chaos.ground import Ground
from tools.bench.chaos.plan import CAMERAS
from tools.stack.programs import SOCKET_FILE
from tools.stack.running import wait_ready
from tools.stack.supervisor import Supervisor, SupervisorError

T = TypeVar("T")
READY_S = 600.0
_BACK_S = 300.0
_DOWN_S = 300.0


class Stack:
    """`tagmill up` and `down` of one rig; what they say goes into the ground's log."""

    def __init__(self, ground: Ground) -> None:
        self.ground = ground
        self.endpoints = Endpoints.of(load_rig(ground.rig).config.network)
        self._environment = {**os.environ, **ground.environment()}
        self._up: subprocess.Popen[bytes] | None = None
        self._supervisor = Supervisor(self.endpoints.run_dir / SOCKET_FILE)
        self.over = threading.Event()
        self._cures = ThreadPoolExecutor(1, "cure")
        self._begun: list[Future[None]] = []

    def up(self) -> None:
        """Start it; waits for nothing."""
        with self.ground.log.open("ab") as sink:
            self._up = subprocess.Popen(self._command("up"), stdout=sink, stderr=sink, env=self._environment)

    def down(self) -> None:
        """Stop it, and wait until it has ended; raises TagmillError if something of it still lives."""
        with self.ground.log.open("ab") as sink:
            done = subprocess.run(
                self._command("down"), stdout=sink, stderr=sink, env=self._environment, timeout=_DOWN_S, check=False
            )
        if self._up is not None:
            try:
                self._up.wait(_BACK_S)
            except subprocess.TimeoutExpired:
                self._up.kill()
                self._up.wait()
                raise TagmillError("supervisord did not end with `tagmill down`") from None
            self._up = None
        if done.returncode:
            raise TagmillError(f"`tagmill down` ended with {done.returncode}; see {self.ground.log}")

    def kill_supervisor(self) -> None:
        """kill -9 of supervisord."""
        if self._up is not None:
            self._up.kill()
            self._up.wait()
            self._up = None

    def cure(self, what: Callable[[], None]) -> None:
        """What an operator does after a fault, beside the next ones; `wait_ready` waits for it."""
        self._begun.append(self._cures.submit(what))

    def wait_ready(self) -> None:
        """Until the roll-call is complete and the cameras stream; raises TagmillError at the deadline."""
        while self._begun:
            self._begun.pop().result()
        with CommandClient(self.endpoints) as client:
            wait_ready(client, CAMERAS, READY_S)

    def pid(self, program: str, other_than: int = 0) -> int:
        """A program's process, as soon as there is one (another than ``other_than``)."""

        def look() -> int | None:
            try:
                pids = {one.name: one.pid for one in self._supervisor.processes()}
            except SupervisorError:
                return None
            pid = pids.get(program, 0)
            return pid if pid not in (0, other_than) else None

        return until(look, _BACK_S, f"{program} to have a process")

    def workers(self, program: str) -> list[psutil.Process]:
        """A service's worker processes."""
        try:
            children = psutil.Process(self.pid(program)).children()
            return [child for child in children if "spawn_main" in " ".join(child.cmdline())]
        except psutil.NoSuchProcess:
            return []

    def _command(self, name: str) -> list[str]:
        return [sys.executable, "-m", "tools", name, "--rig", str(self.ground.rig)]


def send(pid: int, number: signal.Signals) -> None:
    """A signal to a process that may have ended."""
    with suppress(ProcessLookupError):
        os.kill(pid, number)


def until(look: Callable[[], T | None], limit_s: float, what: str) -> T:
    """Ask ``look`` until it gives something; raises TagmillError after ``limit_s``."""
    deadline, pause = monotonic_ns() + int(limit_s * 1e9), Poller()
    while (found := look()) is None:
        if monotonic_ns() > deadline:
            raise TagmillError(f"waited {limit_s:g} s in vain for {what}")
        pause.wait(0.02)
    return found
