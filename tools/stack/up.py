"""`tagmill up`: start the stack of a rig under supervisord."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

from common.bus import Endpoints
from common.config import Rig
from common.errors import EXIT_OK, ConfigError, NameTakenError, TagmillError
from tools.check import checked_rig, chosen_rig, show_mistakes
from tools.stack.console import console_place, no_console
from tools.stack.leftovers import clear, living
from tools.stack.ports import refuse_taken
from tools.stack.programs import CAMERAS_FOLDER, CONFIG_FILE, LOG_FOLDER, SOCKET_FILE, supervisor_config
from tools.stack.supervisor import Supervisor, SupervisorError

DETACH_S = 30.0


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument("--detach", action="store_true", help="return as soon as the supervisor runs")
    parser.add_argument(
        "--new-session", action="store_true", help="where the session's rig differs, begin a new session"
    )


def run(args: argparse.Namespace) -> int:
    """Check the rig, write the supervisor's configuration and become supervisord (or, detached, start it)."""
    path = chosen_rig(args.rig)
    try:
        rig = checked_rig(path)
    except ConfigError as error:
        show_mistakes(path, error, as_json=args.json)
        return error.exit_code
    endpoints = Endpoints.of(rig.config.network)
    endpoints.prepare()
    refuse_second(endpoints)
    refuse_taken(rig.config.network, endpoints, console=no_console(rig.config.network) is None)
    cleared = clear(endpoints)
    config = write_config(rig, endpoints, new_session=args.new_session)
    _tell(rig, endpoints, cleared, as_json=args.json)
    command = [sys.executable, "-m", "supervisor.supervisord", "-c", str(config)]
    return _start_detached(command, endpoints) if args.detach else _become(command)


def refuse_second(endpoints: Endpoints) -> None:
    """Raise NameTakenError if a stack of this prefix runs already."""
    path = endpoints.run_dir / SOCKET_FILE
    stop = "stop it with `tagmill down`, or use another TAGMILL_PREFIX"
    try:
        pid = Supervisor(path).pid()
    except SupervisorError:
        holders = living(endpoints)
        if not holders:
            return
        raise NameTakenError(f"services of '{endpoints.prefix}' run already: {', '.join(holders)}; {stop}") from None
    raise NameTakenError(f"the stack '{endpoints.prefix}' runs already (supervisord is process {pid}); {stop}")


def write_config(rig: Rig, endpoints: Endpoints, *, new_session: bool = False) -> Path:
    """Write the supervisor's configuration into the run folder; returns its path."""
    folder = endpoints.run_dir
    text = supervisor_config(rig, endpoints, new_session=new_session)
    path = folder / CONFIG_FILE
    try:
        for name in (LOG_FOLDER, CAMERAS_FOLDER):
            (folder / name).mkdir(mode=0o700, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"{error.filename} can't be written ({error.strerror}); set TAGMILL_RUN_DIR to a folder of yours"
        ) from error
    return path


def _tell(rig: Rig, endpoints: Endpoints, cleared: tuple[str, ...], *, as_json: bool) -> None:
    config = endpoints.run_dir / CONFIG_FILE
    if as_json:
        document = {
            "ok": True,
            "command": endpoints.command,
            "run_dir": str(endpoints.run_dir),
            "config": str(config),
            "cleared": cleared,
        }
        print(json.dumps(document), flush=True)
        return
    lines = [
        *(f"warning: {text}" for text in rig.warnings),
        *([f"cleared what an earlier stack left: {', '.join(cleared)}"] if cleared else []),
        f"command socket {endpoints.command}, samples in {rig.dataset_root / rig.config.dataset.session}",
        no_console(rig.config.network) or console_place(rig.config.network, endpoints),
        f"logs in {endpoints.run_dir / LOG_FOLDER}, a further camera as a file in {config.parent / CAMERAS_FOLDER}",
    ]
    print("\n".join(lines), flush=True)


def _become(command: list[str]) -> NoReturn:
    """Go on as supervisord in the foreground, so that Ctrl-C and a service manager's signals reach it."""
    os.execv(sys.executable, [*command, "-n"])  # noqa: S606 - a shell in between would keep the signals


def _start_detached(command: list[str], endpoints: Endpoints) -> int:
    """Start supervisord as a daemon; it returns once it has forked, so its socket is asked until it answers."""
    log = endpoints.run_dir / LOG_FOLDER / "supervisord.log"
    try:
        done = subprocess.run(command, timeout=DETACH_S, check=False, capture_output=True, text=True)
    except subprocess.TimeoutExpired as error:
        raise TagmillError(f"supervisord did not start within {DETACH_S:g} s; see {log}", code="no_start") from error
    if done.returncode != 0:
        reason = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no reason given"]
        raise TagmillError(f"supervisord did not start: {reason[0]}; see {log}", code="no_start")
    Supervisor(endpoints.run_dir / SOCKET_FILE).pid()
    return EXIT_OK
