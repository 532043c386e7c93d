"""Journeys 1, 3 and 4 of an operator, as the how-to pages tell them (2 is in test_record_over_the_socket)."""

from __future__ import annotations

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from common.bus import CommandClient, Endpoints
from common.config.models import NetworkConfig
from common.dataset import SessionReader
from tests.support.hygiene import Place, processes_of
from tests.support.stack import ROOT, wait_for
from tests.support.supervised import (
    DEADLINE_S,
    OBJECT,
    SupervisedStack,
    check_session,
    failed,
    logs,
    run_module,
    service_of,
    supervised,
)

pytestmark = [pytest.mark.process, pytest.mark.timeout(400)]

PROGRAMS = {"control", "store", "label", "detect", "capture-cam0", "console"}


# --- journey 1: supervisord -n -c deploy/supervisord.conf


class Deployed:
    """A copy of the project's deploy folder with everything else linked to it, and what one types there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT / "deploy", folder / "deploy", ignore=shutil.ignore_patterns("*.sock*", "*.log*", "*.pid"))
        for name in ("services", "common", "tools"):
            (folder / name).symlink_to(ROOT / name)
        (folder / ".venv").symlink_to(sys.prefix)
        self.run = folder / "deploy" / "run"
        self.log = folder / "supervisord.out"
        self.endpoints = Endpoints.of(NetworkConfig())
        with self.log.open("wb") as sink:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "supervisor.supervisord", "-n", "-c", "deploy/supervisord.conf"],
                cwd=folder,
                stdout=sink,
                stderr=subprocess.STDOUT,
            )

    def supervisorctl(self, *words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "supervisor.supervisorctl", "-c", "deploy/supervisord.conf", *words],
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
        return done.stdout + done.stderr

    def left(self) -> dict[str, object]:
        """Processes of the stack beside supervisord, its socket and lock files, its shared memory."""
        prefix = self.endpoints.prefix
        files = self.endpoints.run_dir.iterdir() if self.endpoints.run_dir.is_dir() else ()
        return {
            "processes": {pid: words for pid, words in processes_of(prefix).items() if pid != self.process.pid},
            "files": [path.name for path in files if stat.S_ISSOCK(path.lstat().st_mode) or path.suffix == ".lock"],
            "shared memory": [path.name for path in Path("/dev/shm").glob(f"tagmill-{prefix}-*")],
        }

    def end(self) -> int:
        """Ctrl-C at supervisord's terminal."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(DEADLINE_S)


NOTHING: dict[str, object] = {"processes": {}, "files": [], "shared memory": []}


@pytest.fixture
def deployed(place: Place, request: pytest.FixtureRequest) -> Iterator[Deployed]:
    # In the test's own run folder, whose path is short enough for the supervisor's socket.
    place.run_root.mkdir(mode=0o700)
    made = Deployed(place.run_root)
    try:
        yield made
    finally:
        if failed(request.node):
            print(logs(made.run, made.log))
        made.end()
        for pid in processes_of(place.prefix):
            psutil.Process(pid).kill()


@pytest.fixture
def stack(deployed: Deployed) -> Iterator[SupervisedStack]:
    """The deployed stack, ready."""
    with CommandClient(deployed.endpoints, DEADLINE_S) as client:
        made = SupervisedStack(deployed.run / "supervisor.sock", client)
        made.wait_ready("cam0")
        made.wait_running()
        yield made


def test_supervisord_starts_the_stack_and_stop_all_leaves_nothing(deployed: Deployed, stack: SupervisedStack) -> None:
    status = stack.status()
    assert set(stack.states()) == PROGRAMS
    assert not status["missing"]
    assert {name: one["phase"] for name, one in status["services"].items()} == {
        service_of(program): "running" for program in PROGRAMS
    }
    assert {service_of(name): pid for name, pid in stack.pids().items()} == {
        name: one["pid"] for name, one in status["services"].items()
    }
    answer = stack.ask(command="record", camera="cam0", timeout_s=60)
    assert answer["ok"], answer

    said = deployed.supervisorctl("stop", "all")

    assert {line for line in said.splitlines() if line} == {f"{program}: stopped" for program in PROGRAMS}
    assert deployed.left() == NOTHING
    assert deployed.end() == 0
    assert deployed.left() == NOTHING
    check_session(deployed.folder / "dataset" / "synthetic")


def kill_and_wait(stack: SupervisedStack) -> None:
    for program in sorted(PROGRAMS):
        stack.wait_back(program, stack.kill(program))


def kill_only(stack: SupervisedStack) -> None:
    """Nobody has had time to come back when all are stopped."""
    for program in sorted(PROGRAMS):
        stack.kill(program)


@pytest.mark.parametrize("kill", [pytest.param(kill_and_wait, marks=pytest.mark.long), kill_only])
def test_stop_all_leaves_nothing_after_kill_9(
    kill: Callable[[SupervisedStack], None], deployed: Deployed, stack: SupervisedStack
) -> None:
    kill(stack)
    deployed.supervisorctl("stop", "all")
    wait_for(lambda: deployed.left()["processes"] == {}, DEADLINE_S, "the last process to end")
    assert deployed.left() == NOTHING


# --- journey 3: a second camera is plugged in


RIG = f"""\
dataset: {{root: ./dataset, session: journey}}
{OBJECT}
cameras:
  cam0: {{driver: synthetic, width: 320, height: 240, fps: 6, prerendered: 6}}
ring: {{slots: 6, samples: 8}}
"""
SECOND = "cameras:\n  cam1: {driver: synthetic, width: 320, height: 240, fps: 5, seed: 2, prerendered: 4}\n"


def supervisorctl(run_dir: Path, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "supervisor.supervisorctl", "-c", str(run_dir / "supervisord.conf"), *words],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    return (done.stdout + done.stderr).strip()


def test_a_second_camera_is_added_recorded_from_and_removed_while_the_rest_runs_on(
    tmp_path: Path, place: Place
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG)
    session = tmp_path / "dataset" / "journey"
    folder = place.run_dir / "conf.d"
    with supervised(rig, "cam0") as stack:
        running = stack.ask(command="start", camera="cam0", every_s=0.5)
        assert running["ok"], running
        before = stack.pids()
        shutil.copy(ROOT / "deploy" / "examples" / "conf.d" / "capture-cam1.conf", folder)
        (folder / "cam1.yaml").write_text(SECOND)
        assert supervisorctl(place.run_dir, "update") == "capture-cam1: added process group"
        stack.wait_ready("cam0", "cam1")
        after = stack.pids()
        assert after.pop("capture-cam1")
        assert after == before
        one = stack.ask(command="record", camera="cam1", count=2, timeout_s=60)
        both = stack.ask(command="record", camera="all", count=1, timeout_s=60)
        assert one["ok"], one
        assert both["ok"], both
        ledger = stack.ask(command="stop", recording=running["recording"])["ledgers"][0]["cameras"]["cam0"]
        assert ledger["captured"] == ledger["recorded"] + sum(ledger["refused"].values()) + sum(
            ledger["dropped"].values()
        )

        (folder / "capture-cam1.conf").unlink()
        said = supervisorctl(place.run_dir, "update")
        assert "capture-cam1: removed process group" in said
        assert stack.pids() == before
        again = stack.ask(command="record", camera="cam0", count=1, timeout_s=60)
        assert again["ok"], again
    reader = SessionReader(session)
    assert [reader.label(name).camera.name for name in one["samples"]] == ["cam1", "cam1"]
    assert sorted(reader.label(name).camera.name for name in both["samples"]) == ["cam0", "cam1"]
    assert {name: cameras[-1].camera.width for name, cameras in reader.session.cameras.items()} == {
        "cam0": 320,
        "cam1": 320,
    }
    check_session(session)


# --- journey 4: the load test


KEYS = {
    *("offered", "captured", "detected", "labelled", "skipped", "ring_overruns"),
    *("latency_p50_ms", "latency_p99_ms"),
}


def bench_load(*options: str) -> dict[str, object]:
    """The load test's document; it has a prefix of its own, of which nothing may stay."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("TAGMILL_")}
    words = ("tools", "bench", "load", "--size", "320x240", "--json", *options)
    pid, done = run_module(*words, timeout_s=300, env=environment)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    prefix = f"load-{pid}"
    assert list(Path("/dev/shm").glob(f"tagmill-{prefix}-*")) == []
    assert processes_of(prefix) == {}
    document: dict[str, object] = json.loads(done.stdout)
    return document


@pytest.mark.long
def test_the_load_test_gives_figures_that_fit_together() -> None:
    load = bench_load("--cameras", "2", "--fps", "8", "--seconds", "3", "--stall-store")
    assert set(load) == {"seconds", "cameras", "processes", "records", "hops"}
    cameras, processes = load["cameras"], load["processes"]
    assert isinstance(cameras, dict)
    assert isinstance(processes, dict)
    assert set(cameras) == {"cam0", "cam1"}
    for name, camera in cameras.items():
        assert set(camera) == KEYS
        assert camera["offered"] > 0, name
        # States come once a second and each tells the count at that moment: one frame of play at each end.
        assert camera["captured"] <= camera["offered"] + 2
        assert 0 < camera["detected"] <= 8 * 3 * 1.5
        assert 0 < camera["labelled"] <= camera["detected"] + 1
        assert 0 < camera["latency_p50_ms"] <= camera["latency_p99_ms"]
        assert camera["ring_overruns"] == camera["skipped"].get("detect: frame_lost", 0)
        assert all(count > 0 for count in camera["skipped"].values())
    assert set(processes) == {"control", "store", "label.0", "detect.0", "capture.cam0", "capture.cam1"}
    assert all(cost["memory_mb"] > 0 and cost["processes"] >= 1 for cost in processes.values())
    records = load["records"]
    assert isinstance(records, dict)
    assert sum(records.values()) > 0
    assert not any(outcome.startswith("no answer") for outcome in records)
