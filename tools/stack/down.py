"""`tagmill down`: stop the stack, wait for its end, clear what a kill -9 left."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from common.bus import Endpoints
from common.clock import monotonic_ns
from common.config import RigConfig, load_rig
from common.config.models import NetworkConfig
from common.errors import EXIT_NO_ANSWER, EXIT_OK, ConfigError
from tools.stack.leftovers import clear, living, orphans
from tools.stack.programs import SOCKET_FILE, STOP_WAIT_S
from tools.stack.supervisor import Supervisor, SupervisorError, wait_for_end, watched

LIMIT_S = 90.0
"""The supervisor stops program after program, each within STOP_WAIT_S."""
ORPHANS_S = float(STOP_WAIT_S)
"""What a service may take to drain and close."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How a stack ended: whether one ran, what still lives, what was cleared away."""

    ran: bool
    alive: tuple[str, ...]
    cleared: tuple[str, ...]


def add_parser(parser: argparse.ArgumentParser) -> None:
    """The sub-command's own arguments."""
    parser.add_argument(
        "--timeout-s", type=float, default=LIMIT_S, help=f"how long to wait for the end (default {LIMIT_S:g})"
    )


def run(args: argparse.Namespace) -> int:
    """Stop the stack; exit code 0 once nothing of it is left, 4 if something didn't end in time."""
    ended = stop(Endpoints.of(_network(args.rig)), args.timeout_s)
    if args.json:
        print(json.dumps({"ok": not ended.alive, "ran": ended.ran, "alive": ended.alive, "cleared": ended.cleared}))
    else:
        print("\n".join(_words(ended)))
    return EXIT_NO_ANSWER if ended.alive else EXIT_OK


def stop(endpoints: Endpoints, timeout_s: float = LIMIT_S) -> Ended:
    """Ask the supervisor to shut down, wait until it has ended (at most ``timeout_s``), clear what is left."""
    supervisor = Supervisor(endpoints.run_dir / SOCKET_FILE)
    try:
        pid = supervisor.pid()
    except SupervisorError:
        return _without_supervisor(endpoints)
    deadline = monotonic_ns() + int(timeout_s * 1e9)
    with watched(pid) as process:
        supervisor.shutdown()
        ended = wait_for_end(process, max(0.0, (deadline - monotonic_ns()) / 1e9))
    alive = living(endpoints)
    if not ended:
        return Ended(True, (f"supervisord (pid {pid})", *alive), ())
    return Ended(True, alive, clear(endpoints))


def _without_supervisor(endpoints: Endpoints) -> Ended:
    """No supervisor of ours: what it left when it was killed drains by itself, else it is asked to end."""
    with ExitStack() as stack:
        found = [stack.enter_context(watched(pid)) for pid in orphans(endpoints)]
        ending = [process for process in found if process is not None]
        # The kernel has told them already, and a second signal would cut their drain short. One that was just
        # being started when its supervisor died knows nothing of it.
        for process in _still_there(ending, ORPHANS_S):
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(process, signal.SIGTERM)
        _still_there(ending, ORPHANS_S)
    return Ended(bool(ending), living(endpoints), clear(endpoints))


def _still_there(processes: list[int], timeout_s: float) -> list[int]:
    """Those that have not ended after ``timeout_s``."""
    deadline = monotonic_ns() + int(timeout_s * 1e9)
    return [one for one in processes if not wait_for_end(one, max(0.0, (deadline - monotonic_ns()) / 1e9))]


def _network(path: Path | None) -> NetworkConfig:
    """Where the stack's sockets are; a rig file that was broken meanwhile must not keep its stack from stopping."""
    if path is None:
        return RigConfig().network
    try:
        return load_rig(path).config.network
    except ConfigError as error:
        text = f"{path} can't be used ({error.problems[0]}); going by the default prefix and TAGMILL_PREFIX"
        print(text, file=sys.stderr)
        return RigConfig().network


def _words(ended: Ended) -> list[str]:
    lines = []
    if ended.alive:
        lines.append(f"still running: {', '.join(ended.alive)}")
        if not ended.ran:
            lines.append("`tagmill up` didn't start them; use: supervisorctl -c <their supervisord.conf> shutdown")
    else:
        lines.append("the stack has stopped" if ended.ran else "no stack was running")
    if ended.cleared:
        lines.append(f"cleared: {', '.join(ended.cleared)}")
    return lines
