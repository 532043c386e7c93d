"""A stack for the length of a block, and waiting until it is ready: for the demo, the load test and tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common import clock
from common.bus import CommandClient, Poller
from common.errors import TagmillError

READY_S = 60.0
_STOP_S = 60.0


@contextmanager
def running_stack(rig: Path, log: Path, environment: Mapping[str, str] | None = None) -> Iterator[None]:
    """`tagmill up` before the block, `tagmill down` after it; both write into ``log``."""
    env = {**os.environ, **(environment or {})}
    with log.open("w") as sink:
        stack = subprocess.Popen(_command("up", rig), stdout=sink, stderr=subprocess.STDOUT, env=env)
        try:
            yield
        finally:
            subprocess.run(_command("down", rig), stdout=sink, stderr=sink, env=env, check=False)
            try:
                stack.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                stack.kill()
                stack.wait()


def interrupt_by_sigterm() -> None:
    """Have SIGTERM do what Ctrl-C does: a command that is told to end takes its stack and its files with it."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


def _command(name: str, rig: Path) -> list[str]:
    return [sys.executable, "-m", "tools", name, "--rig", str(rig)]


def wait_ready(
    client: CommandClient,
    cameras: Collection[str],
    timeout_s: float = READY_S,
    meanwhile: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Wait until the roll-call is complete and the cameras give pictures; returns that status.

    ``meanwhile`` is called in between, a few times a second.

    Raises TagmillError at the deadline, naming what is missing.
    """
    deadline = clock.monotonic_ns() + int(timeout_s * 1e9)
    pause = Poller()
    status: dict[str, Any] = {}
    while clock.monotonic_ns() < deadline:
        meanwhile()
        try:
            status = client.request({"command": "status"}, timeout_s=2.0)
        except TagmillError:
            continue
        if not (lacking := _lacking(status, cameras)):
            return status
        pause.wait(0.1)
    what = ", ".join(lacking) if status else "control"
    raise TagmillError(f"the stack was not ready after {timeout_s:g} s: {what}; see its log")


def _lacking(status: dict[str, Any], cameras: Collection[str]) -> list[str]:
    lacking = [f"{name} is missing" for name in status["missing"]]
    for name, service in status["services"].items():
        if service["phase"] != "running" or not service["alive"]:
            lacking.append(f"{name} is {service['phase']} ({service['last_error'] or 'no error said'})")
    for name in cameras:
        camera = status["cameras"].get(name)
        if camera is None or camera["phase"] not in ("streaming", "waiting", "ended"):
            lacking.append(f"camera {name} gives no picture")
    return lacking
