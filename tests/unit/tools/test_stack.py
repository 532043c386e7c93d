"""The supervisor's configuration, a second start, and what a kill -9 left."""

from __future__ import annotations

import configparser
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus import Endpoints, NameLock
from common.config import Rig, load_rig
from common.errors import EXIT_NAME_TAKEN, ConfigError, NameTakenError
from common.frames import FrameWriter, segment_name, shm_folder
from services.store.choice import CHOICE_FILE
from tests.support.hygiene import Place
from tools.stack.console import no_console
from tools.stack.down import stop
from tools.stack.leftovers import clear, living
from tools.stack.programs import ROOT, programs, supervisor_config
from tools.stack.supervisor import Supervisor, SupervisorError, wait_for_end, watched
from tools.stack.up import refuse_second, write_config

DEPLOY = ROOT / "deploy"


@pytest.fixture
def endpoints(tmp_path: Path, place: Place, monkeypatch: pytest.MonkeyPatch) -> Endpoints:
    """A stack of this test's own, its shared memory included."""
    monkeypatch.setenv("TAGMILL_SHM_DIR", str(tmp_path))
    made = Endpoints.of(load_rig(DEPLOY / "examples" / "synthetic.yaml").config.network)
    made.prepare()
    return made


@pytest.fixture
def rig() -> Rig:
    return load_rig(DEPLOY / "examples" / "synthetic.yaml")


def rig_with(tmp_path: Path, text: str) -> Rig:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return load_rig(path)


def parse(text: str) -> configparser.RawConfigParser:
    """As supervisor reads it."""
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";", "#"), strict=True)
    parser.read_string(text)
    return parser


# --- the configuration


def test_one_program_a_process(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, "cameras: {left: {driver: synthetic}, right: {driver: synthetic}}\nworkers: {label: 2}\n")
    found = {program.name: (program.service, program.arguments) for program in programs(rig, new_session=True)}
    assert found == {
        "control": ("control", ()),
        "store": ("store", ("--new-session",)),
        "label-0": ("label", ("--instance", "0")),
        "label-1": ("label", ("--instance", "1")),
        "detect": ("detect", ("--instance", "0")),
        "capture-left": ("capture", ("--camera", "left")),
        "capture-right": ("capture", ("--camera", "right")),
        "console": ("console", ()),
    }


def test_a_rig_without_a_console_and_a_machine_without_its_packages_have_no_such_program(
    tmp_path: Path, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    without = rig_with(tmp_path, "network: {console: null}\n")
    assert "console" not in {program.name for program in programs(without)}
    assert no_console(without.config.network) == "no console: network.console is null in the rig file"
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "fastapi" else object())
    assert "console" not in {program.name for program in programs(rig)}
    assert "fastapi not installed; pip install 'tagmill[console]'" in (no_console(rig.config.network) or "")


def test_the_console_and_the_cameras_stop_first_and_the_bus_last(rig: Rig) -> None:
    order = [program.service for program in sorted(programs(rig), key=lambda one: -one.priority)]
    assert order == ["console", "capture", "detect", "label", "store", "control"]


def test_every_program_has_the_settings_that_the_stack_relies_on(rig: Rig, endpoints: Endpoints) -> None:
    for text in (supervisor_config(rig, endpoints), (DEPLOY / "supervisord.conf").read_text()):
        parser = parse(text)
        assert not [section for section in parser.sections() if section.startswith("group:")]
        sections = [section for section in parser.sections() if section.startswith("program:")]
        assert len(sections) == 6
        for section in sections:
            settings = dict(parser[section])
            assert settings["startsecs"] == "3"
            assert settings["startretries"] == "1000"
            assert settings["autorestart"] == "unexpected"
            assert settings["exitcodes"] == "0,78"
            assert settings["stopasgroup"] == settings["killasgroup"] == "true"
            assert int(settings["stopwaitsecs"]) > 14
            assert settings["stdout_logfile_maxbytes"]


def test_the_hand_written_file_and_the_example_camera_are_twins_of_what_is_written(
    rig: Rig, endpoints: Endpoints
) -> None:
    written = parse(supervisor_config(rig, endpoints))
    by_hand = parse((DEPLOY / "supervisord.conf").read_text())
    programs_written = {name: dict(written[name]) for name in written.sections() if name.startswith("program:")}
    assert {name: dict(by_hand[name]) for name in by_hand.sections() if name.startswith("program:")} == programs_written

    camera = dict(parse((DEPLOY / "examples" / "conf.d" / "capture-cam1.conf").read_text())["program:capture-cam1"])
    expected = {key: value.replace("cam0", "cam1") for key, value in programs_written["program:capture-cam0"].items()}
    expected["command"] += ' --camera-file "%(here)s/cam1.yaml"'
    assert camera == expected


def test_supervisor_itself_reads_it(rig: Rig, endpoints: Endpoints, tmp_path: Path) -> None:
    """With a blank and a comma in every path, and a further camera in conf.d."""
    from supervisor.options import ServerOptions

    folder = tmp_path / "one, two"
    folder.mkdir()
    rig = rig_with(folder, "cameras: {cam0: {driver: synthetic}}\n")
    run = Endpoints(endpoints.prefix, folder / "run", "ipc://x")
    run.run_dir.mkdir()
    path = write_config(rig, run)
    example = (DEPLOY / "examples" / "conf.d" / "capture-cam1.conf").read_text()
    (run.run_dir / "conf.d" / "capture-cam1.conf").write_text(example)

    options = ServerOptions()
    options.realize(["-c", str(path), "-n"])

    commands = {group.name: group.process_configs[0].command for group in options.process_group_configs}
    assert set(commands) == {"control", "store", "label", "detect", "capture-cam0", "capture-cam1", "console"}
    assert commands["control"] == f'"{sys.executable}" -m services.control --rig "{folder}/rig.yaml"'
    assert commands["capture-cam1"].endswith(f'--camera-file "{folder}/run/conf.d/cam1.yaml"')
    assert options.process_group_configs[0].process_configs[0].directory == str(ROOT)


def test_a_path_that_the_configuration_can_t_express_is_refused(endpoints: Endpoints, tmp_path: Path) -> None:
    for name in ('a"b', "a ;b", "a #b", "a\\b", "a%b"):
        folder = tmp_path / name
        folder.mkdir()
        rig = rig_with(folder, "cameras: {}\n")
        with pytest.raises(ConfigError, match="can't express"):
            supervisor_config(rig, endpoints)


# --- a second start


def test_a_stack_without_a_supervisor_of_ours_is_not_started_over(endpoints: Endpoints) -> None:
    refuse_second(endpoints)
    with NameLock(endpoints.service_lock("store"), "store"), pytest.raises(NameTakenError, match="store") as caught:
        refuse_second(endpoints)
    assert caught.value.exit_code == EXIT_NAME_TAKEN
    refuse_second(endpoints)


# --- a supervisor that runs


@pytest.fixture
def running(endpoints: Endpoints, tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A supervisord with the head of our configuration and one program that needs no stack."""
    rig = rig_with(tmp_path, "cameras: {}\n")
    path = write_config(rig, endpoints)
    head = path.read_text().partition("[program:")[0]
    path.write_text(f"{head}\n[program:sleeper]\ncommand=sleep 1000\nstartsecs=0\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "supervisor.supervisord", "-n", "-c", str(path)], stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    for line in process.stdout:  # ends with the process; pytest's timeout is the deadline
        if b"sleeper entered RUNNING" in line:
            break
    yield process
    if process.poll() is None:
        process.kill()
    process.wait(10)
    process.stdout.close()


def test_down_stops_it_and_leaves_nothing(running: subprocess.Popen[bytes], endpoints: Endpoints) -> None:
    (program,) = Supervisor(endpoints.run_dir / "supervisor.sock").processes()
    assert (program.name, program.state) == ("sleeper", "RUNNING")
    with pytest.raises(NameTakenError, match=f"supervisord is process {running.pid}"):
        refuse_second(endpoints)

    with watched(program.pid) as sleeper:
        ended = stop(endpoints, 30.0)
        assert wait_for_end(sleeper, 5.0)

    assert (ended.ran, ended.alive) == (True, ())
    assert running.wait(10) == 0
    assert {path.name for path in endpoints.run_dir.iterdir()} == {"supervisord.conf", "log", "conf.d"}
    again = stop(endpoints, 5.0)
    assert (again.ran, again.alive, again.cleared) == (False, (), ())


def test_what_a_killed_supervisor_left_is_cleared(running: subprocess.Popen[bytes], endpoints: Endpoints) -> None:
    (program,) = Supervisor(endpoints.run_dir / "supervisor.sock").processes()
    running.kill()
    running.wait(10)
    subprocess.run(["kill", "-9", str(program.pid)], check=True)

    ended = stop(endpoints, 5.0)

    assert not ended.ran
    assert {"supervisor.sock", "supervisord.pid"} <= set(ended.cleared)
    assert {path.name for path in endpoints.run_dir.iterdir()} == {"supervisord.conf", "log", "conf.d"}


def test_an_orphan_that_knows_nothing_of_it_is_asked_to_end(
    endpoints: Endpoints, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service that was just starting when its supervisor was killed: not told by the kernel, not yet draining."""
    monkeypatch.setattr("tools.stack.down.ORPHANS_S", 2.0)
    script = (
        "import sys\nfrom pathlib import Path\nfrom common.bus import NameLock\n"
        "lock = NameLock(Path(sys.argv[1]), 'store')\nprint('ready', flush=True)\nsys.stdin.read()\n"
    )
    lock = endpoints.service_lock("store")
    orphan = subprocess.Popen(
        [sys.executable, "-c", script, str(lock)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    )
    assert orphan.stdout is not None
    assert orphan.stdin is not None
    try:
        assert orphan.stdout.readline() == b"ready\n"
        ended = stop(endpoints)
        assert orphan.wait(5) == -15
    finally:
        if orphan.poll() is None:
            orphan.kill()
        orphan.wait(10)
        orphan.stdin.close()
        orphan.stdout.close()
    assert (ended.ran, ended.alive, ended.cleared) == (True, (), ("store.lock",))


def test_nobody_answers(endpoints: Endpoints) -> None:
    with pytest.raises(SupervisorError, match="no supervisor answers"):
        Supervisor(endpoints.run_dir / "supervisor.sock").pid()


# --- leftovers

_HOLDER = """
import os, socket, sys
from pathlib import Path
from common.bus import NameLock
from common.frames import FrameWriter, segment_name
run, prefix = Path(sys.argv[1]), sys.argv[2]
NameLock(run / "orders-store.lock", "store")
lock = NameLock(run / "store.lock", "store")
held = NameLock(run / "publish.lock", "the bus proxy")
bound = socket.socket(socket.AF_UNIX); bound.bind(str(run / "publish"))
ring = FrameWriter(segment_name(prefix, "cam0", "dead0000"), 64, 48, False, 3)
print("ready", flush=True)
sys.stdin.read()
os.kill(os.getpid(), 9)
"""


def test_only_what_the_dead_left_is_cleared(endpoints: Endpoints) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(endpoints.run_dir), endpoints.prefix],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=ROOT,
    )
    assert holder.stdout is not None
    assert holder.stdin is not None
    assert holder.stdout.readline() == b"ready\n"
    mine = FrameWriter(segment_name(endpoints.prefix, "cam1", "a11ve000"), 64, 48, False, 3)
    try:
        found = living(endpoints)
        assert any(re.fullmatch(rf"store \(pid {holder.pid}\)", one) for one in found), found
        held = {path.name for path in endpoints.run_dir.iterdir()}
        clear(endpoints)
        assert {"store.lock", "publish.lock", "publish"} <= {path.name for path in endpoints.run_dir.iterdir()} <= held

        holder.communicate(timeout=10)
        cleared = clear(endpoints)

        assert {"store.lock", "publish.lock", "publish"} <= set(cleared)
        assert [path for path in endpoints.run_dir.iterdir() if path.is_socket() or path.suffix == ".lock"] == []
        assert [path.name for path in shm_folder().iterdir() if path.name.startswith("tagmill-")] == [
            segment_name(endpoints.prefix, "cam1", "a11ve000")
        ]
        assert segment_name(endpoints.prefix, "cam0", "dead0000") in cleared
        assert clear(endpoints) == ()
    finally:
        mine.close()
        if holder.poll() is None:
            holder.kill()
            holder.wait(10)


def test_the_session_that_was_chosen_is_forgotten_with_its_stack(endpoints: Endpoints) -> None:
    (endpoints.run_dir / CHOICE_FILE).write_bytes(b"{}")
    assert clear(endpoints) == ()
    assert list(endpoints.run_dir.iterdir()) == []


def test_a_socket_without_a_lock_is_nobody_s(endpoints: Endpoints) -> None:
    path = endpoints.run_dir / "left"
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(path))
    assert clear(endpoints) == ("left",)
    assert not path.exists()
