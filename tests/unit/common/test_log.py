"""The log: never in the way, honest about what it lost."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from common import log
from common.errors import RefusedError
from common.log import QueueWriter
from tests.support.stack import ROOT, wait_for

SMALL_PIPE = 4096


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """A pipe that takes 4 KiB."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, SMALL_PIPE)
    yield reading, writing
    for end in (reading, writing):
        try:
            os.close(end)
        except OSError:
            continue


@pytest.fixture
def lines(tmp_path: Path) -> Iterator[Any]:
    """Log into a file; call it for the events so far."""
    path = tmp_path / "log"
    with path.open("w") as stream:
        log.setup("label.0", "debug", stream)

        def read() -> list[dict[str, Any]]:
            log.shutdown()
            return [json.loads(line) for line in path.read_text().splitlines()]

        yield read
        log.shutdown()


def test_an_event_is_a_json_line_with_its_service(lines: Any) -> None:
    log.get(camera="cam0").info("frame.dropped", reason="late")
    [event] = lines()
    assert event.pop("timestamp").endswith("Z")
    assert event == {
        "event": "frame.dropped",
        "level": "info",
        "service": "label.0",
        "camera": "cam0",
        "reason": "late",
    }


def test_a_thread_logs_as_its_service_too(lines: Any) -> None:
    thread = threading.Thread(target=lambda: log.get().info("from.thread"))
    thread.start()
    thread.join(5)
    assert lines()[0]["service"] == "label.0"


def test_a_logger_made_before_set_up_follows_it(tmp_path: Path) -> None:
    early = log.get()
    with (tmp_path / "log").open("w") as stream:
        log.setup("store", stream=stream)
        early.info("record.stored")
        log.shutdown()
    assert "record.stored" in (tmp_path / "log").read_text()


def test_an_expected_refusal_has_no_traceback_and_a_bug_has_one(lines: Any) -> None:
    for error in (RefusedError("no room", code="disk_full"), ValueError("a bug")):
        try:
            raise error
        except (RefusedError, ValueError):
            log.get().exception("order.failed")
    refusal, bug = lines()
    assert (refusal["code"], refusal["reason"]) == ("disk_full", "no room")
    assert "exception" not in refusal
    assert "Traceback" in bug["exception"]
    assert "a bug" in bug["exception"]


def test_levels_and_libraries(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import logging

    path = tmp_path / "log"
    with path.open("w") as stream:
        log.setup("store", "warning", stream)
        log.get().info("quiet")
        logging.getLogger("zmq.auth").warning("said %d", 5)
        log.shutdown()
    log.get().info("heard again")
    assert "heard again" in capsys.readouterr().err
    [event] = [json.loads(line) for line in path.read_text().splitlines()]
    assert (event["event"], event["text"], event["logger"]) == ("library.said", "said 5", "zmq.auth")


def test_odd_values_do_not_break_a_line(lines: Any) -> None:
    log.get().info("odd", path=Path("/x"), text="line\nbreak \udcff", data=b"\xff")
    [event] = lines()
    assert event["path"] == "/x"
    assert "break" in event["text"]


def test_a_stalled_reader_blocks_nobody_and_the_loss_is_told(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    writer = QueueWriter(writing, size=10)
    line = json.dumps({"event": "x" * 1000})
    for _ in range(200):
        writer.write(line)  # would block for ever if it did
    assert writer.dropped >= 200 - 10 - SMALL_PIPE // 1000 - 1
    assert not writer.flush(0.05)
    lost = writer.dropped
    got = b""
    os.set_blocking(reading, False)

    def read_on() -> bool:
        nonlocal got
        with contextlib.suppress(BlockingIOError):
            got += os.read(reading, 1 << 16)
        return writer.flush(0.02)

    wait_for(read_on, 10, "the writer to catch up")
    writer.write(json.dumps({"event": "last"}))
    wait_for(lambda: read_on() and b"last" in got, 10, "the last line")
    events = [json.loads(text) for text in got.splitlines()]
    assert sum(event["count"] for event in events if event["event"] == "log.dropped") == lost
    assert len(events) - sum(event["event"] == "log.dropped" for event in events) == 200 - lost + 1
    writer.close()


def test_a_reader_that_is_gone_is_no_error(pipe: tuple[int, int]) -> None:
    reading, writing = pipe
    os.close(reading)
    writer = QueueWriter(writing)
    writer.write("lost")
    writer.close()
    assert writer.dropped == 1


def test_the_end_of_a_process_waits_for_a_stalled_pipe_only_for_a_moment(pipe: tuple[int, int]) -> None:
    _, writing = pipe
    script = (
        "from common import log\n"
        "log.setup('store')\n"
        "for number in range(5000):\n"
        "    log.get().info('number', number=number)\n"
        "print('through', flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], cwd=ROOT, stderr=writing, stdout=subprocess.PIPE, text=True
    )
    out, _ = process.communicate(timeout=30)
    assert out == "through\n"
    assert process.returncode == 0


def test_everything_is_there_after_a_normal_end() -> None:
    script = "from common import log\nlog.setup('s')\nfor n in range(500): log.get().info('number', number=n)\n"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, stderr=subprocess.PIPE, text=True, check=True, timeout=30
    )
    assert [json.loads(line)["number"] for line in done.stderr.splitlines()] == list(range(500))


def test_a_forked_child_logs_too() -> None:
    script = (
        "import os\nfrom common import log\nlog.setup('s')\nlog.get().info('parent')\nlog.shutdown\n"
        "pid = os.fork()\n"
        "if pid == 0:\n"
        "    log.get().info('child')\n"
        "    log.shutdown()\n"
        "    os._exit(0)\n"
        "os.waitpid(pid, 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        check=True,
        timeout=30,
    )
    assert sorted(json.loads(line)["event"] for line in done.stderr.splitlines()) == ["child", "parent"]


def test_on_a_terminal_it_is_readable() -> None:
    leader, follower = os.openpty()
    termios.tcsetwinsize(follower, (40, 200))
    script = "from common import log\nlog.setup('store')\nlog.get().info('record.stored', sample='s1')\n"
    subprocess.run([sys.executable, "-c", script], cwd=ROOT, stderr=follower, check=True, timeout=30)
    os.set_blocking(leader, False)
    text = os.read(leader, 4096).decode()
    os.close(leader)
    os.close(follower)
    assert "record.stored" in text
    assert not text.lstrip().startswith("{")


def test_set_up_again_replaces_the_writer(tmp_path: Path) -> None:
    with (tmp_path / "a").open("w") as first, (tmp_path / "b").open("w") as second:
        log.setup("one", stream=first)
        log.get().info("a")
        log.setup("two", stream=second)
        log.get().info("b")
        log.shutdown()
        log.shutdown()
    assert json.loads((tmp_path / "a").read_text())["service"] == "one"
    assert json.loads((tmp_path / "b").read_text())["service"] == "two"
