"""Real processes for tests: started as in production, watched, their logs shown when a test fails."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import psutil

from common.bus import Endpoints, Poller, Received, Subscriber
from common.config.models import NetworkConfig
from common.messages import ServiceState
from common.topics import SERVICE, Topic
from tests.support.hygiene import SETTLE_S, Place, processes_of
from tests.support.rigs import SIDES, box

ROOT = Path(__file__).resolve().parents[2]
START_S = 30.0
STOP_S = 15.0

T = TypeVar("T")

RIG = (
    """\
dataset: {root: ./dataset, session: test}
objects:
"""
    + box(marker_size_mm=100, sides=SIDES[:2])
    + """\
cameras:
  cam0: {driver: synthetic, width: 320, height: 240, fps: 10}
  cam1: {driver: synthetic, width: 320, height: 240, fps: 10, seed: 2}
ring: {slots: 6, samples: 4}
"""
)


def write_rig(folder: Path, text: str = RIG) -> Path:
    """A rig file in ``folder``."""
    path = folder / "rig.yaml"
    path.write_text(text)
    return path


def wait_for(what: Callable[[], T | None], deadline_s: float = START_S, why: str = "") -> T:
    """Ask ``what`` until it gives something true; fails after ``deadline_s``. For states without a message."""
    deadline = time.monotonic() + deadline_s
    while True:
        found = what()
        if found:
            return found
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {deadline_s:g} s in vain for {why or what}")
        time.sleep(0.01)


class ServiceProcess:
    """One started process with its log in a file."""

    def __init__(self, module: str, arguments: tuple[str, ...], log_path: Path, **environment: str) -> None:
        self.name = module
        self.log_path = log_path
        with log_path.open("wb") as output:
            self.popen = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment},
            )

    @property
    def pid(self) -> int:
        return self.popen.pid

    @property
    def running(self) -> bool:
        return self.popen.poll() is None

    def send_signal(self, number: signal.Signals) -> None:
        self.popen.send_signal(number)

    def kill(self) -> None:
        """kill -9, and wait for it."""
        self.popen.kill()
        self.popen.wait(STOP_S)

    def stop(self, number: signal.Signals = signal.SIGTERM, deadline_s: float = STOP_S) -> int:
        """Ask it to end and return the exit code."""
        self.popen.send_signal(number)
        return self.wait(deadline_s)

    def wait(self, deadline_s: float = STOP_S) -> int:
        """Wait for its end; the exit code (negative: the signal that killed it)."""
        try:
            return self.popen.wait(deadline_s)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"{self.name} still runs after {deadline_s:g} s:\n{self.log()}") from error

    def log(self) -> str:
        return self.log_path.read_text(errors="replace")

    def events(self, name: str | None = None) -> list[dict[str, Any]]:
        """The JSON lines of its log, all or those of one event."""
        found = []
        for line in self.log().splitlines():
            if line.startswith("{") and line.endswith("}"):
                event = json.loads(line)
                if name is None or event.get("event") == name:
                    found.append(event)
        return found

    def wait_for_event(self, name: str, deadline_s: float = START_S) -> dict[str, Any]:
        """Wait until its log has this event."""

        def look() -> dict[str, Any] | None:
            found = self.events(name)
            if not found and not self.running:
                raise AssertionError(f"{self.name} ended ({self.popen.returncode}) without {name}:\n{self.log()}")
            return found[0] if found else None

        return wait_for(look, deadline_s, f"event {name} of {self.name}; its log:\n{self.log()}")

    def cpu_s(self) -> float:
        """CPU seconds used so far."""
        times = psutil.Process(self.pid).cpu_times()
        return float(times.user + times.system)


class Listener:
    """A subscriber to wait with."""

    def __init__(self, endpoints: Endpoints, *topics: Topic) -> None:
        self.subscriber = Subscriber(endpoints)
        self.heard: list[Received] = []
        for topic in topics:
            self.subscriber.subscribe(topic)

    def wait_for(
        self, wanted: Callable[[Received], bool], deadline_s: float = START_S, why: str = "a message"
    ) -> Received:
        """The next message (from now on) that ``wanted`` takes."""
        deadline = time.monotonic() + deadline_s
        poller = Poller(self.subscriber)
        while (left_s := deadline - time.monotonic()) > 0:
            poller.wait(min(left_s, 0.5))
            came = self.subscriber.receive()
            self.heard += came
            for received in came:
                if wanted(received):
                    return received
        raise AssertionError(f"waited {deadline_s:g} s in vain for {why}; heard {len(self.heard)} messages")

    def wait_for_state(
        self, service: str, *phases: str, boot_not: str | None = None, deadline_s: float = START_S
    ) -> ServiceState:
        """The next heartbeat of ``service`` in one of ``phases`` (default: running)."""

        def fits(received: Received) -> bool:
            state = received.message
            return (
                isinstance(state, ServiceState)
                and state.service == service
                and state.phase in (phases or ("running",))
                and state.boot != boot_not
            )

        why = f"{service} to be {'/'.join(phases or ('running',))}"
        state = self.wait_for(fits, deadline_s, why).message
        assert isinstance(state, ServiceState)
        return state

    def close(self) -> None:
        self.subscriber.close()


class Stack:
    """The processes of one test. The fixture ``stack`` stops what still runs and shows the logs on failure."""

    def __init__(self, place: Place, folder: Path) -> None:
        self.place = place
        self.folder = folder
        self.endpoints = Endpoints.of(NetworkConfig())
        self.processes: list[ServiceProcess] = []
        self._listeners: list[Listener] = []

    def start_service(self, name: str, rig: Path, *arguments: str, **environment: str) -> ServiceProcess:
        """``python -m services.NAME --rig F ...``."""
        return self.start_module(f"services.{name}", "--rig", str(rig), *arguments, **environment)

    def start_module(self, module: str, *arguments: str, **environment: str) -> ServiceProcess:
        """``python -m MODULE ...``; waits for nothing."""
        log_path = self.folder / f"{len(self.processes):02}-{module.rpartition('.')[2]}.log"
        process = ServiceProcess(module, arguments, log_path, **environment)
        self.processes.append(process)
        return process

    def listen(self, *topics: Topic) -> Listener:
        """A listener to ``topics`` (default: heartbeats); closed with the test."""
        listener = Listener(self.endpoints, *(topics or (SERVICE,)))
        self._listeners.append(listener)
        return listener

    def close(self) -> list[str]:
        """Stop everything; what had to be killed or is still there."""
        for listener in self._listeners:
            listener.close()
        running = [process for process in self.processes if process.running]
        for process in running:
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGTERM)
        stubborn = []
        for process in running:
            try:
                process.popen.wait(STOP_S)
            except subprocess.TimeoutExpired:
                stubborn.append(process.name)
                process.kill()
        # Helpers of multiprocessing end a moment after the process that they helped.
        deadline = time.monotonic() + SETTLE_S
        while (left := processes_of(self.place.prefix)) and time.monotonic() < deadline:
            time.sleep(0.02)
        return stubborn + [f"{pid}: {command}" for pid, command in left.items()]

    def logs(self) -> str:
        """All logs, for the report of a failed test."""
        return "\n".join(
            f"--- {process.log_path.name} (exit {process.popen.poll()})\n{process.log()[-6000:]}"
            for process in self.processes
        )
