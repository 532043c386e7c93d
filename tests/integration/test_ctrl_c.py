"""`tagmill up` in the foreground, ended by a signal at any moment; started twice; its supervisor killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from common.bus import CommandClient, Endpoints
from common.config.models import NetworkConfig
from common.errors import EXIT_INTERRUPTED, EXIT_NAME_TAKEN
from tests.support.hygiene import Place, processes_of
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, NO_PAGE, failed, logs
from tools.stack.down import stop
from tools.stack.programs import LOG_FOLDER, SOCKET_FILE
from tools.stack.running import wait_ready
from tools.stack.supervisor import Supervisor, SupervisorError

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

RIG = f"""\
dataset: {{root: ./dataset, session: ctrl-c}}
{NO_PAGE}
cameras:
  cam0: {{driver: synthetic, width: 320, height: 240, fps: 10, prerendered: 4}}
ring: {{slots: 6, samples: 4}}
"""


class Up:
    """`tagmill up` as somebody types it."""

    def __init__(self, folder: Path) -> None:
        self.rig = folder / "rig.yaml"
        self.rig.write_text(RIG)
        self.log = folder / "up.log"
        self.endpoints = Endpoints.of(NetworkConfig())
        with self.log.open("wb") as sink:
            self.process = subprocess.Popen(command(self.rig), stdout=sink, stderr=subprocess.STDOUT)

    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def supervisor(self) -> Supervisor | None:
        made = Supervisor(self.endpoints.run_dir / SOCKET_FILE)
        try:
            made.pid()
        except SupervisorError:
            return None
        return made

    def end(self, number: signal.Signals) -> int:
        self.process.send_signal(number)
        return self.process.wait(DEADLINE_S)

    def wait_ready(self) -> None:
        with CommandClient(self.endpoints) as client:
            wait_ready(client, ["cam0"], DEADLINE_S)

    def left(self) -> list[str]:
        """What is still in the run folder beside the configuration and the logs."""
        folder = self.endpoints.run_dir
        if not folder.is_dir():
            return []
        return sorted({path.name for path in folder.iterdir()} - {"supervisord.conf", "log", "conf.d"})


def command(rig: Path) -> list[str]:
    return [sys.executable, "-m", "tools", "up", "--rig", str(rig)]


@pytest.fixture
def up(tmp_path: Path, place: Place, request: pytest.FixtureRequest) -> Iterator[Up]:
    made = Up(tmp_path)
    try:
        yield made
    finally:
        if failed(request.node):
            print(logs(made.endpoints.run_dir / LOG_FOLDER, made.log))
        stop(made.endpoints, DEADLINE_S)
        if made.process.poll() is None:
            made.process.kill()
        made.process.wait(DEADLINE_S)
        remaining = [psutil.Process(pid) for pid in processes_of(place.prefix)]
        for process in psutil.wait_procs(remaining, timeout=10)[1]:
            process.kill()


# --- a signal at some moment


def at_once(_: Up) -> None:
    """Before Python has imported anything."""


def while_checking(up: Up) -> None:
    """Python runs, and has its eyes on the rig."""
    wait_for(lambda: up.endpoints.run_dir.is_dir(), DEADLINE_S, "the run folder")


def as_the_supervisor_starts(up: Up) -> None:
    wait_for(lambda: (up.endpoints.run_dir / SOCKET_FILE).exists(), DEADLINE_S, "the supervisor's socket")


def as_the_services_start(up: Up) -> None:
    """Their interpreters run; none has opened anything."""
    wait_for(lambda: len(psutil.Process(up.process.pid).children()) == 5, DEADLINE_S, "five processes")


def as_the_services_open(up: Up) -> None:
    """Some have taken their name."""
    wait_for(lambda: list(up.endpoints.run_dir.glob("*.lock")), DEADLINE_S, "a service's lock")


def when_ready(up: Up) -> None:
    up.wait_ready()


EARLY = (at_once, while_checking, as_the_supervisor_starts)
LATE = (as_the_services_start, as_the_services_open, when_ready)
QUICK = {
    (at_once, signal.SIGINT),
    (while_checking, signal.SIGTERM),
    (as_the_supervisor_starts, signal.SIGINT),
    (as_the_services_start, signal.SIGTERM),
    (when_ready, signal.SIGINT),
}
"""Almost each moment once; the other combinations belong to the long runs."""
CASES = [
    pytest.param(
        moment,
        number,
        id=f"{moment.__name__}-{number.name}",
        marks=() if (moment, number) in QUICK else pytest.mark.long,
    )
    for moment in (*EARLY, *LATE)
    for number in (signal.SIGINT, signal.SIGTERM)
]


@pytest.mark.parametrize(("moment", "number"), CASES)
def test_a_signal_ends_everything(moment: Callable[[Up], None], number: signal.Signals, up: Up, place: Place) -> None:
    moment(up)
    code = up.end(number)
    expected = {0} if moment in LATE else {0, EXIT_INTERRUPTED, -number}
    cut_at_its_birth = moment is at_once and "Fatal Python error: init" in up.said()  # not a line of ours ran yet
    assert code in expected or cut_at_its_birth, up.said()
    assert processes_of(place.prefix) == {}
    if moment is when_ready:
        assert up.left() == []
        assert "Traceback" not in up.said() + logs(up.endpoints.run_dir / LOG_FOLDER)
    # The supervisor may have been cut off while it was starting; what it left, `down` removes.
    ended = stop(up.endpoints, DEADLINE_S)
    assert (ended.ran, ended.alive) == (False, ())
    assert up.left() == []


def test_a_benchmark_that_is_told_to_end_takes_its_stack_with_it(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.run_root.mkdir()
    monkeypatch.setenv("TMPDIR", str(place.run_root))
    bench = subprocess.Popen([sys.executable, "-m", "tools", "bench", "soak", "--minutes", "5", "--size", "320x240"])
    try:
        wait_for(lambda: len(_stack_of(bench.pid)) >= 9, DEADLINE_S, "the services and their workers")
        bench.terminate()
        assert bench.wait(DEADLINE_S) == EXIT_INTERRUPTED
    finally:
        bench.kill()
        bench.wait()
    assert _stack_of(bench.pid) == {}
    assert list(place.run_root.iterdir()) == []


def _stack_of(soak: int) -> dict[int, str]:
    return processes_of(f"soak-{soak}")


# --- a second start


def test_a_second_up_is_refused_and_changes_nothing(up: Up) -> None:
    up.wait_ready()
    supervisor = up.supervisor()
    assert supervisor is not None
    before = [(process.name, process.pid) for process in supervisor.processes()]
    second = subprocess.run(command(up.rig), capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert second.returncode == EXIT_NAME_TAKEN
    assert f"supervisord is process {up.process.pid}" in second.stderr
    assert "tagmill down" in second.stderr
    assert "Traceback" not in second.stderr
    assert [(process.name, process.pid) for process in supervisor.processes()] == before
    assert up.end(signal.SIGTERM) == 0
    assert up.left() == []


# --- the supervisor is killed


@pytest.mark.parametrize(
    "moment", [as_the_services_start, pytest.param(as_the_services_open, marks=pytest.mark.long), when_ready]
)
def test_services_end_by_themselves_when_their_supervisor_is_killed(
    moment: Callable[[Up], None], up: Up, place: Place
) -> None:
    moment(up)
    up.process.kill()
    assert up.process.wait(DEADLINE_S) == -signal.SIGKILL
    wait_for(lambda: processes_of(place.prefix) == {}, DEADLINE_S, f"the services' end: {processes_of(place.prefix)}")
    ended = stop(up.endpoints, DEADLINE_S)
    assert (ended.ran, ended.alive) == (False, ())
    assert up.left() == []


def test_down_right_after_the_supervisor_was_killed(up: Up, place: Place) -> None:
    up.wait_ready()
    os.kill(up.process.pid, signal.SIGKILL)
    up.process.wait(DEADLINE_S)
    down = subprocess.run(
        [sys.executable, "-m", "tools", "down", "--rig", str(up.rig)],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert down.returncode == 0, down.stdout + down.stderr
    assert processes_of(place.prefix) == {}
    assert up.left() == []
