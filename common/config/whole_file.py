"""Files beside the rig are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from common.errors import ConfigError


def write_whole(path: Path, text: str, cure: str) -> None:
    """Replace ``path`` by a file of ``text``, in a folder that exists; raises ConfigError, which ends with ``cure``."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ConfigError(f"{path} can't be written: {error.strerror}; {cure}") from error
