"""The command line: quick help, one table, exit codes, what a person and what a program gets to read."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from common.bus import CommandServer, Endpoints, Poller
from common.commands import COMMANDS
from common.config.models import NetworkConfig
from common.errors import EXIT_BAD_CONFIG, EXIT_INTERRUPTED, EXIT_NO_ANSWER, EXIT_OK, EXIT_REFUSED, EXIT_USAGE
from services.control.describe import help_answer
from tools.cli import SUB_COMMANDS, build_parser, main
from tools.commands.client import network_of
from tools.dataset.command import ACTIONS

ROOT = Path(__file__).resolve().parents[3]
ENV = {**os.environ, "PYTHONPATH": str(ROOT)}

Answer = Callable[[dict[str, Any]], dict[str, Any]]
Stub = Callable[[Answer], list[dict[str, Any]]]


@pytest.fixture
def control() -> Iterator[Stub]:
    """A real command socket whose answers the test gives; returns the list of requests as they come."""
    ends: list[Callable[[], None]] = []

    def start(answer: Answer) -> list[dict[str, Any]]:
        asked: list[dict[str, Any]] = []
        endpoints = Endpoints.of(NetworkConfig())
        endpoints.prepare()
        server, stop = CommandServer(endpoints, None), threading.Event()

        def serve() -> None:
            poller = Poller(server)
            while not stop.is_set():
                poller.wait(0.02)
                for return_, data in server.receive():
                    asked.append(msgpack.unpackb(data))
                    server.answer(return_, answer(asked[-1]))
            server.close()

        thread = threading.Thread(target=serve)
        thread.start()

        def end() -> None:
            stop.set()
            thread.join(5.0)

        ends.append(end)
        return asked

    yield start
    for end in ends:
        end()


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def account(**more: Any) -> dict[str, Any]:
    plain = {"captured": 9, "labelled": 9, "recorded": 6, "refused": {"no_object": 2}, "dropped": {"detect": 1}}
    return {**plain, "pending": 0, **more}


def ledger(phase: str = "ended") -> dict[str, Any]:
    spec = {"recording": "rec-1", "mode": "all", "cameras": ["cam0"], "every_s": 0.0, "until_count": None}
    return {"spec": spec, "phase": phase, "ended_at": None, "why": None, "cameras": {"cam0": account()}}


def status() -> dict[str, Any]:
    service = {
        "alive": True,
        "age_s": 0.2,
        "restarts": 1,
        "phase": "running",
        "pid": 12,
        "rates": {"stored": 2.0},
        "dropped": {"superseded": 3},
        "last_error": "the disk is slow",
        "warnings": [{"wall_ns": 1, "code": "x", "message": "look here"}],
    }
    camera = {"present": True, "age_s": 0.1, "phase": "streaming", "width": 640, "height": 480, "fps": 30.0}
    camera |= {"depth": True, "calibration": "factory", "captured": 77, "lost": {}, "last_error": None}
    recording = {"phase": "running", "cameras": {"cam0": account()}, "waiting_for": {"cam0": "no_object"}}
    return {
        "ok": True,
        "services": {"store": service},
        "missing": ["label.0"],
        "cameras": {"cam0": camera},
        "recordings": {"rec-1": recording},
        "shares": {"detect": {"cam0": 0}, "label": {"cam0": 0}},
        "backlog": 4,
        "disk": {"free_bytes": 12_300_000_000},
        "session": "monday",
        "prefix": "tagmill",
    }


def test_help_names_every_sub_command_and_imports_none(capsys: pytest.CaptureFixture[str]) -> None:
    script = (
        "import sys; from tools.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as end:\n    assert end.code == 0\n"
        "heavy = [name for name in sys.modules if name.split('.')[0] in ('cv2', 'numpy', 'zmq', 'pydantic', 'rich')]\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode == 0, done.stderr
    for row in SUB_COMMANDS:
        assert f"\n    {row.name}" in done.stdout


@pytest.mark.parametrize("row", SUB_COMMANDS, ids=[row.name for row in SUB_COMMANDS])
def test_every_sub_command_has_its_module_and_help(row: Any, capsys: pytest.CaptureFixture[str]) -> None:
    _, modules = build_parser([row.name])
    assert callable(modules[row.name].run)
    with pytest.raises(SystemExit) as end:
        main([row.name, "--help"])
    assert end.value.code == EXIT_OK
    assert "--rig" in capsys.readouterr().out


def test_every_command_of_the_socket_has_a_sub_command() -> None:
    below_dataset = {"delete": "delete", "restore": "restore", "samples": "list"}
    assert set(below_dataset.values()) <= set(ACTIONS)
    assert set(COMMANDS) - set(below_dataset) <= {row.name for row in SUB_COMMANDS}


def test_wrong_usage_is_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == EXIT_USAGE
    for words in (["fly"], ["record", "--count", "many"], ["ledger"]):
        with pytest.raises(SystemExit) as end:
            main(words)
        assert end.value.code == EXIT_USAGE


def test_nobody_there_is_exit_code_4_and_says_what_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.commands.session.SESSION_S", 0.1)
    assert main(["session", "monday"]) == EXIT_NO_ANSWER
    told = capsys.readouterr().err
    assert "no tagmill answers at ipc://" in told
    assert "start it with 'tagmill up --rig rig.yaml'" in told


def test_record_prints_the_names(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    asked = control(lambda _: {"ok": True, "recording": "rec-1", "samples": ["a", "b"], "pending": []})
    assert main(["record", "--camera", "cam0", "--count", "2", "--timeout", "3"]) == EXIT_OK
    assert capsys.readouterr().out == "a\nb\n"
    (request,) = asked
    assert request == {
        "command": "record",
        "camera": "cam0",
        "count": 2,
        "interval_s": 0.0,
        "timeout_s": 3.0,
        "background": False,
    }


def test_a_refusal_is_exit_code_3_in_words_and_keeps_what_is_stored(
    control: Stub, capsys: pytest.CaptureFixture[str]
) -> None:
    error = {"code": "no_object", "message": "cam1: no configured object is in view"}
    control(lambda _: {"ok": False, "error": error, "samples": ["a"], "pending": ["b"]})
    assert main(["record"]) == EXIT_REFUSED
    told = capsys.readouterr()
    assert told.out == "a\n"
    for part in ("b is not durable yet", "No object in view.", "cam1: no configured", "Turn a side with a marker"):
        assert part in told.err


def test_json_is_the_answer_itself(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    answer = {"ok": False, "error": {"code": "no_object", "message": "none"}, "samples": ["a"], "pending": []}
    control(lambda _: answer)
    assert main(["record", "--json"]) == EXIT_REFUSED
    told = capsys.readouterr()
    assert (json.loads(told.out), told.err) == (answer, "")


def test_status_shows_what_matters(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    control(lambda _: status())
    assert main(["status"]) == EXIT_OK
    told = capsys.readouterr().out
    for part in (
        *("not complete", "label.0 is missing", "store: the disk is slow", "store: look here", "monday"),
        *(
            "12.3 GB free",
            "4 samples wait",
            "640x480 + depth",
            "factory",
            "superseded 3",
            "rec-1 waits on cam0: no_object",
        ),
    ):
        assert part in told
    assert main(["status", "--json"]) == EXIT_OK
    assert json.loads(capsys.readouterr().out) == status()


def test_watching_ends_with_ctrl_c_and_exit_code_0(
    control: Stub, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = control(lambda _: status())
    monkeypatch.setattr("tools.commands.status.EVERY_S", 0.0)

    def third(_: dict[str, Any]) -> object:
        if len(asked) >= 3:
            raise KeyboardInterrupt
        return "shown"

    monkeypatch.setattr("tools.commands.status.status_view", third)
    assert main(["status", "--watch"]) == EXIT_OK
    assert len(asked) == 3


def test_start_prints_the_id_and_who_is_missing(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    asked = control(lambda _: {"ok": True, "recording": "rec-1", "cameras": ["cam0"], "missing": ["cam1"]})
    assert main(["start", "--every", "2", "--until-count", "5", "--mode", "auto"]) == EXIT_OK
    told = capsys.readouterr()
    assert told.out == "rec-1\n"
    assert "cam1 is not there" in told.err
    assert (asked[0]["every_s"], asked[0]["until_count"], asked[0]["mode"]) == (2.0, 5, "auto")


def test_start_wait_stays_until_the_end_and_prints_the_ledger(
    control: Stub, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.commands.start.LOOK_EVERY_S", 0.0)
    phases = iter(["running", "finishing", "ended"])

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        if request["command"] == "start":
            return {"ok": True, "recording": "rec-1", "cameras": ["cam0"], "missing": []}
        return {"ok": True, "ledger": ledger(next(phases))}

    asked = control(answer)
    assert main(["start", "--wait"]) == EXIT_OK
    told = capsys.readouterr().out
    for part in ("rec-1: ended", "cam0", "2 (no_object 2)", "1 (detect 1)"):
        assert part in told
    assert [request["command"] for request in asked] == ["start", "ledger", "ledger", "ledger"]


def test_stop_and_ledger_print_the_account(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    asked = control(lambda request: {"ok": True, "ledgers": [ledger()], "ledger": ledger()})
    assert main(["stop"]) == EXIT_OK
    assert main(["ledger", "rec-1"]) == EXIT_OK
    assert capsys.readouterr().out.count("2 (no_object 2)") == 2
    assert asked == [{"command": "stop"}, {"command": "ledger", "recording": "rec-1"}]


def test_stop_says_so_when_nothing_ran(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    control(lambda _: {"ok": True, "ledgers": []})
    assert main(["stop"]) == EXIT_OK
    assert capsys.readouterr().out == "Nothing was being recorded.\n"


def test_a_reload_of_a_bad_file_is_exit_code_78_with_all_mistakes(
    control: Stub, capsys: pytest.CaptureFixture[str]
) -> None:
    problems = ["rig.yaml:3: objects: wrong", "rig.yaml:9: cameras: wrong too"]
    control(lambda _: {"ok": False, "error": {"code": "bad_config", "message": "2 mistakes"}, "problems": problems})
    assert main(["reload"]) == EXIT_BAD_CONFIG
    told = capsys.readouterr().err
    assert all(problem in told for problem in problems)


def test_reload_session_preview_and_help(control: Stub, capsys: pytest.CaptureFixture[str]) -> None:
    control(
        lambda request: {
            "reload": {"ok": True, "changed": ["cameras"], "restart": ["capture.cam0"], "warnings": ["hm"]},
            "session": {"ok": True, "session": "monday-2"},
            "preview": {"ok": True, "cameras": ["cam0"], "lease_s": 5.0},
            "help": {"ok": True, **help_answer()},
        }[request["command"]]
    )
    for words in (["reload"], ["session", "monday"], ["preview", "cam0", "--seconds", "0"], ["help", "record"]):
        assert main(words) == EXIT_OK
    told = capsys.readouterr().out
    for part in (
        "taken over: cameras",
        " restart capture-cam0",
        "monday-2 is open",
        "whole number 1..1000",
    ):
        assert part in told


def test_a_mistake_elsewhere_in_the_rig_file_keeps_nobody_from_stopping(elsewhere: Path, control: Stub) -> None:
    (elsewhere / "rig.yaml").write_text("objects: 17\nnetwork: {command: 'tcp://127.0.0.1:5751', keys: k}\n")
    network, folder = network_of(Path("rig.yaml"))
    assert (network.command, network.keys, folder) == ("tcp://127.0.0.1:5751", Path("k"), elsewhere)
    control(lambda _: {"ok": True, "ledgers": []})
    (elsewhere / "rig.yaml").write_text("objects: 17\n")
    assert main(["stop"]) == EXIT_OK


@pytest.mark.parametrize("text", ["network: 5\n", "network: {prefix: [\n", "network: {prefx: a}\n"])
def test_a_rig_file_that_hides_the_stack_is_exit_code_78(
    elsewhere: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (elsewhere / "rig.yaml").write_text(text)
    assert main(["stop"]) == EXIT_BAD_CONFIG
    told = capsys.readouterr().err
    assert "rig.yaml" in told
    assert "'tagmill check' says all that is wrong" in told
    assert main(["stop", "--rig", "nowhere.yaml"]) == EXIT_BAD_CONFIG


def test_ctrl_c_while_a_sub_command_is_imported_shows_no_traceback(elsewhere: Path) -> None:
    (elsewhere / "slowly.py").write_text(
        "import sys, threading\nprint('importing', flush=True)\nthreading.Event().wait(60)\n"
    )
    script = (
        "import sys, tools.cli as cli\n"
        "cli.SUB_COMMANDS += (cli.SubCommand('slow', 'slowly', 'imported slowly'),)\n"
        "sys.path.append('.')\n"
        "sys.exit(cli.main(['slow']))\n"
    )
    command = [sys.executable, "-c", script]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=elsewhere, env=ENV, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        _, complained = process.communicate(timeout=60)
    assert process.returncode == EXIT_INTERRUPTED
    assert complained == ""


def test_keys_are_made_once_and_clients_added(elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", "mine"]) == EXIT_OK
    told = capsys.readouterr().out
    assert "network: {keys: mine}" in told
    assert "tagmill keys mine --client NAME" in told
    assert (elsewhere / "mine" / "server.key_secret").stat().st_mode & 0o077 == 0
    assert main(["keys", "mine"]) == EXIT_REFUSED
    assert main(["keys", "mine", "--client", "tablet", "--json"]) == EXIT_OK
    made = json.loads(capsys.readouterr().out)["files"]
    assert "mine/authorized/tablet.key" in made
