"""Which life of the stack this is: a recording goes on after a crash of a service, not after one of the stack."""

from __future__ import annotations

import os
from pathlib import Path

from common.dataset import StackLife

_START_TIME_FIELD = 22
_NAME_END = ")"


def stack_life(supervisor: int | None = None) -> StackLife:
    """The life of the supervisor process (default: this process's parent)."""
    pid = os.getppid() if supervisor is None else supervisor
    return StackLife(pid=pid, started=_started(pid), machine_boot=_machine_boot())


def _started(pid: int) -> int:
    # The process's name, in brackets, may hold blanks: fields are counted after it (it is field 2).
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(_NAME_END)[2].split()
    return int(fields[_START_TIME_FIELD - 3])


def _machine_boot() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
