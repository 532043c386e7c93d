"""The runner and orders with real processes: a small service that goes through it like every other."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from common.bus import OrderClient, Poller, holder_of
from common.messages import Answer, LedgerQuery
from common.topics import SERVICE
from tests.support.echo import DONE
from tests.support.stack import ROOT, Listener, ServiceProcess, Stack, wait_for, write_rig

pytestmark = pytest.mark.process
ECHO = "tests.support.echo"
BUS = "tests.support.bus_only"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return write_rig(tmp_path)


def echo(stack: Stack, rig: Path, *arguments: str) -> ServiceProcess:
    return stack.start_module(ECHO, "--rig", str(rig), *arguments)


def opened(process: ServiceProcess) -> ServiceProcess:
    process.wait_for_event("service.opened")
    return process


def order(stack: Stack, key: str, what: str | None = None) -> OrderClient:
    """An order to the echo service, on its way."""
    client = OrderClient(stack.endpoints.ipc("echo-orders"), "test")
    client.peer_seen("any")
    wait_for(lambda: client.available, 2, "the connection")
    client.send(LedgerQuery(key=key, recording=what))
    return client


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_0_and_nothing_is_left(stack: Stack, rig: Path, number: signal.Signals) -> None:
    process = opened(echo(stack, rig))
    assert holder_of(stack.endpoints.service_lock("echo")) == f"echo (pid {process.pid})"
    assert process.stop(number) == 0
    assert list(stack.endpoints.run_dir.iterdir()) == []
    assert [event["phase"] for event in process.events("service.state")] == ["running", "draining", "stopped"]
    assert process.events("service.state")[1]["why"] == number.name


def test_the_heartbeat_tells_the_states_up_to_the_last(stack: Stack, rig: Path) -> None:
    stack.start_module(BUS, "--rig", str(rig))
    listener = stack.listen(SERVICE)
    process = echo(stack, rig)
    state = listener.wait_for_state("echo", "running")
    assert state.pid == process.pid
    client = order(stack, "f", "faulty")
    assert listener.wait_for_state("echo", "faulty").boot == state.boot
    client.close()
    process.send_signal(signal.SIGTERM)
    listener.wait_for_state("echo", "stopped")
    assert process.wait() == 0


def test_any_start_order_brings_the_heartbeat_through(stack: Stack, rig: Path) -> None:
    listener = stack.listen(SERVICE)
    opened(echo(stack, rig))
    stack.start_module(BUS, "--rig", str(rig))
    assert listener.wait_for_state("echo", "running").service == "echo"


def test_a_second_one_is_refused_with_69_and_names_the_holder(stack: Stack, rig: Path) -> None:
    first = opened(echo(stack, rig))
    second = echo(stack, rig, "--name-wait-s", "0.5")
    assert second.wait() == 69
    assert f"echo (pid {first.pid})" in second.log()
    assert "Traceback" not in second.log()
    assert first.stop() == 0


def test_a_name_given_back_in_time_is_taken(stack: Stack, rig: Path) -> None:
    first = opened(echo(stack, rig))
    second = echo(stack, rig, "--name-wait-s", "20")
    second.wait_for_event("service.name_taken")
    assert first.stop() == 0
    opened(second)
    assert second.stop() == 0


def test_waiting_for_a_name_can_be_stopped(stack: Stack, rig: Path) -> None:
    opened(echo(stack, rig))
    second = echo(stack, rig)
    second.wait_for_event("service.name_taken")
    assert second.stop() == 0


def test_after_kill_9_the_next_one_starts_over_the_leftovers(stack: Stack, rig: Path) -> None:
    opened(echo(stack, rig)).kill()
    assert (stack.endpoints.run_dir / "echo-orders").exists()
    second = opened(echo(stack, rig))
    assert second.stop() == 0
    assert list(stack.endpoints.run_dir.iterdir()) == []


BAD_RIG = "objects:\n  - nmae: box\ncameras: []\n"


def test_a_bad_rig_tells_all_and_ends_with_78_after_startsecs(stack: Stack, tmp_path: Path) -> None:
    process = echo(stack, write_rig(tmp_path, BAD_RIG))
    started = psutil.Process(process.pid).create_time()
    wait_for(lambda: "can't be used" in process.log(), 20, "the report")
    assert process.running
    assert process.wait() == 78
    assert time.time() - started >= 3.0
    assert "nmae" in process.log()
    assert "cameras" in process.log()
    assert "Traceback" not in process.log()


def test_a_bad_command_line_is_a_bad_configuration(stack: Stack) -> None:
    process = stack.start_module(ECHO, "--rig", "r.yaml", "--unknown")
    wait_for(lambda: "command line" in process.log(), 20, "the report")
    process.send_signal(signal.SIGTERM)  # also ends the stay
    assert process.wait() == 78


def test_a_file_where_the_run_folder_should_be(stack: Stack, rig: Path) -> None:
    stack.place.run_root.write_text("")
    process = echo(stack, rig)
    wait_for(lambda: "is a file" in process.log(), 20, "the report")
    assert process.stop() == 78
    stack.place.run_root.unlink()


def test_a_bug_has_a_traceback_and_ends_with_1(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "b", "bug")
    assert process.wait() == 1
    client.close()
    assert "RuntimeError: told to have a bug" in process.log()
    assert list(stack.endpoints.run_dir.iterdir()) == []


def test_a_crashed_thread_is_a_bug_of_the_service(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "b", "thread-bug")
    assert process.wait() == 1
    client.close()
    assert process.events("thread.crashed")[0]["thread"] == "crasher"


def test_a_thread_that_hangs_in_a_driver_does_not_spoil_the_end(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "t", "thread-stuck")
    wait_for(client.receive, 10, "the answer")
    client.close()
    assert process.stop() == 0
    assert process.events("service.threads_left")[0]["threads"] == ["stuck"]


@pytest.mark.long
def test_a_service_that_never_comes_back_is_ended_and_says_where_it_hung(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "h", "hang")
    wait_for(lambda: (rig.parent / DONE).exists(), 10, "the order to be taken")
    client.close()
    assert process.stop(deadline_s=30) == 1
    assert "Timeout" in process.log()
    assert "_obey" in process.log()
    opened(echo(stack, rig)).stop()  # clears what the hard end left


def test_a_log_nobody_reads_does_not_stop_the_service(stack: Stack, rig: Path) -> None:
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    process = subprocess.Popen([sys.executable, "-m", ECHO, "--rig", str(rig)], cwd=ROOT, stderr=writing)
    os.close(writing)
    try:
        client = OrderClient(stack.endpoints.ipc("echo-orders"), "test")
        got: list[Answer] = []
        for number in range(200):  # each changes the state, and says so in the log
            client.send(LedgerQuery(key=f"k{number}", recording="faulty"))
            wait_for(lambda: got.extend(client.receive()) or not client.pending, 20, f"answer {number}")
        client.close()
        process.terminate()
        assert process.wait(20) == 0
    finally:
        process.kill()
        os.close(reading)
    assert len(got) == 200


def test_the_second_signal_cuts_the_drain(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "s", "slow-drain")
    wait_for(client.receive, 10, "the answer")
    client.close()
    process.send_signal(signal.SIGTERM)
    wait_for(lambda: len(process.events("service.state")) > 1, 10, "draining")
    assert process.running
    assert process.stop() == 0
    assert process.events("service.drain_cut")[0]["forced"] is True


def test_it_ends_when_its_parent_dies(stack: Stack, rig: Path) -> None:
    log_path = rig.with_name("orphan.log")
    script = (
        "import subprocess, sys, os, signal\n"
        f"out = open({str(log_path)!r}, 'wb')\n"
        f"p = subprocess.Popen([sys.executable, '-m', {ECHO!r}, '--rig', {str(rig)!r}], stderr=out)\n"
        "print(p.pid, flush=True)\n"
        "signal.pause()\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    wait_for(lambda: "service.opened" in log_path.read_text(), 20, "the service")
    parent.kill()
    parent.wait(5)
    parent.stdout.close()
    psutil.wait_procs([child], timeout=10)
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
    assert list(stack.endpoints.run_dir.iterdir()) == []


def test_an_idle_service_uses_almost_no_cpu(stack: Stack, rig: Path) -> None:
    processes = [stack.start_module(BUS, "--rig", str(rig)), echo(stack, rig)]
    listener = stack.listen(SERVICE)
    for name in ("proxy", "echo"):
        listener.wait_for_state(name, "running")
    began, before = time.monotonic(), [process.cpu_s() for process in processes]
    beats = 0

    def counted(received: object) -> bool:
        nonlocal beats
        beats += 1
        return beats >= 6  # three seconds of two services

    listener.wait_for(counted)
    span = time.monotonic() - began
    for process, used in zip(processes, before, strict=True):
        assert (process.cpu_s() - used) / span < 0.02, process.name


def test_an_order_survives_the_kill_of_its_server_and_is_done_once(stack: Stack, rig: Path) -> None:
    stack.start_module(BUS, "--rig", str(rig))
    listener = stack.listen(SERVICE)
    first = echo(stack, rig)
    boot = listener.wait_for_state("echo", "running").boot
    client = OrderClient(stack.endpoints.ipc("echo-orders"), "test")
    client.peer_seen(boot)
    for key, what in (("a", None), ("b", "die-once"), ("c", None)):
        client.send(LedgerQuery(key=key, recording=what))
    answers = _answers_until(client, listener, lambda got: not first.running)
    assert first.wait() == -signal.SIGKILL
    echo(stack, rig)
    answers += _answers_until(client, listener, lambda got: not client.pending)
    assert sorted(answer.key for answer in answers) == ["a", "b", "c"]
    assert sorted((rig.parent / DONE).read_text().split()) == ["a", "b", "c"]
    client.close()


def test_an_order_to_a_stopped_server_is_answered_when_it_goes_on(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    client = order(stack, "first")
    wait_for(client.receive, 10, "the first answer")
    process.send_signal(signal.SIGSTOP)
    wait_for(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED, 5, "the stop")
    for number in range(20):
        client.send(LedgerQuery(key=f"k{number}"))
    assert not Poller(client).wait(0.3)
    process.send_signal(signal.SIGCONT)
    got: list[Answer] = []
    wait_for(lambda: got.extend(client.receive()) or len(got) == 20, 10, "20 answers")
    assert [answer.key for answer in got] == [f"k{number}" for number in range(20)]
    assert client.repeated == 0
    client.close()


def _answers_until(client: OrderClient, listener: Listener, done: object) -> list[Answer]:
    """Answers while the peer's heartbeats are passed on to the client, as every service does it."""
    answers: list[Answer] = []
    poller = Poller(client, listener.subscriber)
    deadline = time.monotonic() + 20
    while not done(answers):  # type: ignore[operator]
        assert time.monotonic() < deadline, (answers, client.pending)
        poller.wait(0.1)
        answers += client.receive()
        for received in listener.subscriber.receive():
            if received.keys == ("echo",):
                client.peer_seen(received.message.boot)  # type: ignore[attr-defined]
    return answers


def test_the_log_is_json_with_the_service_bound(stack: Stack, rig: Path) -> None:
    process = opened(echo(stack, rig))
    event = process.events("service.opened")[0]
    assert event["service"] == "echo"
    assert event["pid"] == process.pid
