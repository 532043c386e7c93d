"""The programs of a rig's stack, and the supervisor configuration that runs them (deploy/supervisord.conf's twin)."""

from __future__ import annotations

import os
import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from common.bus import Endpoints
from common.config import Rig
from common.errors import ConfigError
from tools.stack.console import no_console

ROOT = Path(__file__).resolve().parents[2]
"""Where `services` is imported from."""
CONFIG_FILE = "supervisord.conf"
SOCKET_FILE = "supervisor.sock"
PID_FILE = "supervisord.pid"
LOG_FOLDER = "log"
CAMERAS_FOLDER = "conf.d"

STOP_WAIT_S = 20
"""Above the runner's limits: 10 s to drain and 4 s to close, after which a service ends itself."""

# Stopped in reverse: first no new frames, then what is on its way is finished, the store after those who order
# from it, the bus last.
_CONTROL, _STORE, _LABEL, _DETECT, _CAPTURE, _CONSOLE = 10, 20, 30, 40, 50, 60


@dataclass(frozen=True, slots=True)
class Program:
    """One process under the supervisor: its name there, the service and its arguments."""

    name: str
    service: str
    arguments: tuple[str, ...]
    priority: int


def programs(rig: Rig, *, new_session: bool = False) -> tuple[Program, ...]:
    """What runs for a rig: control, store, the label and detect workers, one capture a camera, the console."""
    workers = rig.config.workers
    store = ("--new-session",) if new_session else ()
    console = (Program("console", "console", (), _CONSOLE),) if no_console(rig.config.network) is None else ()
    return (
        Program("control", "control", (), _CONTROL),
        Program("store", "store", store, _STORE),
        *_workers("label", workers.label, _LABEL),
        *_workers("detect", workers.detect, _DETECT),
        *(Program(f"capture-{name}", "capture", ("--camera", name), _CAPTURE) for name in rig.config.cameras),
        *console,
    )


def _workers(service: str, count: int, priority: int) -> tuple[Program, ...]:
    names = [service] if count == 1 else [f"{service}-{instance}" for instance in range(count)]
    return tuple(Program(name, service, ("--instance", str(instance)), priority) for instance, name in enumerate(names))


def supervisor_config(rig: Rig, endpoints: Endpoints, *, new_session: bool = False) -> str:
    """The whole text of the supervisor's configuration; raises ConfigError for a path that it can't express.

    The run folder's ``conf.d/*.conf`` are included: a further file there and ``supervisorctl update`` add a camera.
    """
    run = _text(endpoints.run_dir)
    head = _HEAD.format(
        rig=_text(rig.path.absolute()),
        run=run,
        config=CONFIG_FILE,
        socket=f"{run}/{SOCKET_FILE}",
        pid=f"{run}/{PID_FILE}",
        log=f"{run}/{LOG_FOLDER}",
        user="user=root\n" if os.getuid() == 0 else "",
        environment=_environment(rig, endpoints),
        cameras=f"{run}/{CAMERAS_FOLDER}",
        folder=CAMERAS_FOLDER,  # relative: the value is split at blanks
    )
    return "\n".join([head, *(_section(program) for program in programs(rig, new_session=new_session))])


_HEAD = """\
; Written by `tagmill up` for {rig}; the next `up` writes it anew.
; A further camera: a file in {cameras}, then
;   supervisorctl -c {run}/{config} update

[unix_http_server]
file={socket}
chmod=0700

[rpcinterface:supervisor]
supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface

[supervisorctl]
serverurl=unix://{socket}

[supervisord]
pidfile={pid}
logfile={log}/supervisord.log
logfile_maxbytes=10MB
logfile_backups=3
childlogdir={log}
{user}environment={environment}

[include]
files={folder}/*.conf
"""


def _environment(rig: Rig, endpoints: Endpoints) -> str:
    """What the programs' lines refer to, and where the stack's sockets are, whoever calls later."""
    values = {
        "TAGMILL_PYTHON": Path(sys.executable),
        "TAGMILL_ROOT": ROOT,
        "TAGMILL_RIG": rig.path.absolute(),
        "TAGMILL_LOG": endpoints.run_dir / LOG_FOLDER,
        "TAGMILL_RUN_DIR": endpoints.run_dir.parent,
        "TAGMILL_PREFIX": Path(endpoints.prefix),
    }
    return ",".join(f'{name}="{_text(value)}"' for name, value in values.items())


def _section(program: Program) -> str:
    arguments = "".join(f" {shlex.quote(word)}" for word in program.arguments)
    return f"""\
[program:{program.name}]
command="%(ENV_TAGMILL_PYTHON)s" -m services.{program.service} --rig "%(ENV_TAGMILL_RIG)s"{arguments}
directory=%(ENV_TAGMILL_ROOT)s
priority={program.priority}
startsecs=3
startretries=1000
autorestart=unexpected
exitcodes=0,78
stopasgroup=true
killasgroup=true
stopwaitsecs={STOP_WAIT_S}
redirect_stderr=true
stdout_logfile=%(ENV_TAGMILL_LOG)s/{program.name}.log
stdout_logfile_maxbytes=10MB
stdout_logfile_backups=3
"""


# supervisor expands some values once and `environment` twice, so that no escape of a percent sign fits all.
_UNSPEAKABLE = re.compile(r"[\"'\\%\x00-\x1f]|\s[;#]")


def _text(path: Path) -> str:
    """A path as the supervisor's configuration writes it."""
    text = str(path)
    if _UNSPEAKABLE.search(text):
        raise ConfigError(
            f"the path {text!r} holds a quote, a backslash, a percent sign, a ' ;' or a ' #', which the supervisor's "
            "configuration can't express; use another place"
        )
    return text
