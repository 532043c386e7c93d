"""A service whose supervisor died must not live on unseen."""

from __future__ import annotations

import ctypes
import os
import signal

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int, number: signal.Signals = signal.SIGTERM) -> bool:
    """Have the kernel send ``number`` when this process's parent dies; Linux only.

    ``parent`` is the parent's pid as read at the very start. False if it has died already. (The kernel means the
    *thread* that started this process: supervisord has one.)
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(number), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    return os.getppid() == parent
