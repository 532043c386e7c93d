"""A service whose supervisor died must not live on unseen."""

from __future__ import annotations

import ctypes
import os
import signal
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_SUPERVISED = "SUPERVISOR_ENABLED"
"""supervisord sets this for its programs."""


def die_with_parent(parent: int, number: signal.Signals = signal.SIGTERM) -> bool:
    """Have the kernel send ``number`` when this process's parent dies; Linux only.

    ``parent`` is the parent's pid as read at the very start. False if it has died already. (The kernel means the
    *thread* that started this process: supervisord has one.)
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    return os.getppid() == parent and not _lost_its_supervisor()


def _lost_its_supervisor() -> bool:
    """Whether a supervisord started this process (or an ancestor of it), and is an ancestor no longer.

    An interpreter needs a moment to start and to import; a supervisor that dies in that moment is dead before
    this process first asks for its parent, which is then init or another that adopts orphans, alive and well.
    An ancestor that can't be looked at (``hidepid``) is taken for the supervisor.
    """
    if _SUPERVISED not in os.environ:
        return False
    pid = os.getppid()
    while pid > 0:
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            stat = Path(f"/proc/{pid}/stat").read_text()
        except OSError:
            return False
        if b"supervisord" in command:
            return False
        pid = int(stat.rpartition(")")[2].split()[1])
    return True
