"""A SIGTERM that reached supervisord's child before its exec is gone; the service stops nevertheless."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.hygiene import Place, processes_of
from tests.support.stack import ROOT, wait_for, write_rig
from tools.stack.supervisor import Supervisor

pytestmark = pytest.mark.process

DEAF_AT_FIRST = """\
import os, signal, sys
signal.signal(signal.SIGTERM, lambda *_: None)
open(sys.argv[1], "w").close()
with open(sys.argv[2]) as gate:
    gate.read()
os.execv(sys.executable, [sys.executable, "-m", "tests.support.echo", "--rig", sys.argv[3]])
"""

CONF = """\
[unix_http_server]
file={run}/s.sock
[supervisord]
nodaemon=true
logfile={run}/s.log
pidfile={run}/s.pid
[rpcinterface:supervisor]
supervisor.rpcinterface_factory = supervisor.rpcinterface:make_main_rpcinterface
[supervisorctl]
serverurl=unix://{run}/s.sock
[program:echo]
command={python} {run}/deaf.py {run}/deaf {run}/gate {rig}
directory={root}
startsecs=0
autorestart=false
stopwaitsecs=40
stdout_logfile={run}/echo.log
redirect_stderr=true
"""


def test_a_service_that_is_stopped_before_its_exec_ends_by_itself(place: Place, tmp_path: Path) -> None:
    run = place.run_root
    run.mkdir(exist_ok=True)
    (run / "deaf.py").write_text(DEAF_AT_FIRST)
    os.mkfifo(run / "gate")
    conf = run / "s.conf"
    conf.write_text(CONF.format(run=run, python=sys.executable, rig=write_rig(tmp_path), root=ROOT))
    supervisord = subprocess.Popen(
        [sys.executable, "-m", "supervisor.supervisord", "-c", str(conf)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    supervisor = Supervisor(run / "s.sock")
    try:
        wait_for((run / "deaf").exists, 30, "the child, deaf as supervisord's before its exec")
        stopping = subprocess.Popen(
            [sys.executable, "-m", "supervisor.supervisorctl", "-c", str(conf), "stop", "echo"],
            stdout=subprocess.DEVNULL,
        )
        wait_for(lambda: supervisor.processes()[0].state == "STOPPING", 30, "the stop")
        with (run / "gate").open("w"):
            pass
        assert stopping.wait(60) == 0
        assert supervisor.processes()[0].state in {"STOPPED", "EXITED"}
        log = (run / "echo.log").read_text()
        assert "service.opened" not in log, "it was stopped before it began"
    finally:
        supervisord.send_signal(signal.SIGTERM)
        supervisord.wait(90)
    wait_for(lambda: processes_of(place.prefix) == {}, 30, "the last process to end")
