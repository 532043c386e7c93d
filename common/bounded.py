"""Reading what strangers wrote, within bounds: whatever is in a file, memory and time stay those of a sensible one."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any

_PART = 1 << 20


class TooLargeError(ValueError):
    """A file is larger than its kind ever is."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"it is larger than {_words(limit)}")


def read_bytes(path: Path, limit: int) -> bytes:
    """All of a file; raises TooLargeError beyond ``limit`` bytes, OSError.

    Counted while reading: a device or a pipe has no size beforehand. A pipe that nobody writes to is empty, not
    waited for.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with open(descriptor, "rb", buffering=0) as file:  # noqa: PTH123 - a descriptor, not a path
        told = os.fstat(descriptor)
        if stat.S_ISFIFO(told.st_mode):
            os.set_blocking(descriptor, True)
        if told.st_size > limit:
            raise TooLargeError(limit)
        found = bytearray()
        while part := file.read(min(_PART, limit + 1 - len(found))):
            found += part
            if len(found) > limit:
                raise TooLargeError(limit)
        return bytes(found)


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text; raises ValueError for what is none, or is nested beyond what the stack holds."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _words(size: int) -> str:
    return f"{size >> 20} MiB" if size >= 1 << 20 else f"{size >> 10} KiB"
