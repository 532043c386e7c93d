"""How a process that works on pictures treats its memory."""

from __future__ import annotations

import ctypes
import gc

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""glibc's malloc.h."""
_LARGEST = 32 << 20
"""mallopt takes no larger threshold."""
_KEPT = 256 << 20


def keep_freed_memory() -> bool:
    """Have malloc keep what is freed, instead of giving it back to the kernel after every picture.

    A 1280x720 picture is 675 pages, and each that comes anew costs a page fault: they were half of what encoding took.
    False where the C library has no such thing; then nothing is changed.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _LARGEST) and mallopt(_M_TRIM_THRESHOLD, _KEPT))


def keep_all() -> None:
    """Leave everything that has been made so far out of the search for garbage, and begin to search.

    What a service imported and opened stays until its end; a search through all of it takes longer than a frame may.
    """
    gc.freeze()
    gc.enable()
