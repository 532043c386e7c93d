"""Why the command socket of a stack gives no answer, from what its supervisor and control's log say."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from tools.stack.programs import LOG_FOLDER, SOCKET_FILE
from tools.stack.supervisor import Supervisor, SupervisorError

_ASK_S = 2.0
_TAIL_BYTES = 64 * 1024


def why_silent(run_dir: Path) -> str | None:
    """One sentence, or None if no supervisord runs for this run folder: then the stack isn't up."""
    try:
        supervisor = Supervisor(run_dir / SOCKET_FILE, _ASK_S)
        pid = supervisor.pid()
        control = next((state for state in supervisor.processes() if state.name == "control"), None)
    except SupervisorError:
        return None
    log = run_dir / LOG_FOLDER / "control.log"
    where = f"its supervisord runs (process {pid}), control is {control.state if control else 'no program of it'}"
    return f"{where}; {_last_complaint(log) or f'see {log}'}"


def _last_complaint(log: Path) -> str | None:
    """The reason that control's newest warning or error gives, if control has not run properly since."""
    try:
        with log.open("rb") as source:
            source.seek(max(0, os.fstat(source.fileno()).st_size - _TAIL_BYTES))
            lines = source.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    for line in reversed(lines):
        entry = _entry(line)
        if entry.get("phase") == "running":
            return None
        if entry.get("level") in {"warning", "error", "critical"} and isinstance(entry.get("reason"), str):
            return str(entry["reason"])
    return None


def _entry(line: str) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        return {}  # a line of the interpreter's own, or one cut in half
    return found if isinstance(found, dict) else {}
