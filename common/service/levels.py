"""How much each service of a stack logs, changed while it runs: a small file in the run folder that all look at.

Not a command over the bus: the service of which one wants to know more is often the one that hears nothing. The file
also holds for a service that is started anew, and goes with the stack (`tagmill down`).
"""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from common import log
from common.bounded import read_bytes
from common.config.whole_file import write_whole
from common.log import Level

LEVELS_FILE = "log-levels.json"
ALL = "*"
_MOST_BYTES = 1 << 16

_FILE: TypeAdapter[dict[str, Level]] = TypeAdapter(dict[str, Level])


def read_levels(run_dir: Path) -> dict[str, Level]:
    """By service id, ``*`` for all others; nothing where there is no such file, or one that makes no sense."""
    try:
        return _FILE.validate_json(read_bytes(run_dir / LEVELS_FILE, _MOST_BYTES), strict=True)
    except (OSError, ValueError, ValidationError):
        return {}


def write_level(run_dir: Path, service: str, level: Level | None) -> dict[str, Level]:
    """Set a service's level (``*``: of all, whatever was set for one), or take it back; returns what holds now.

    Raises ConfigError if it can't be written.
    """
    levels = {} if service == ALL else read_levels(run_dir)
    levels.pop(service, None)
    if level is not None:
        levels[service] = level
    path = run_dir / LEVELS_FILE
    write_whole(path, _FILE.dump_json(levels).decode(), "is the stack of another user?")
    return levels


class LevelWatch:
    """Keeps one service at its level; ``look`` costs a microsecond where nothing has changed."""

    def __init__(self, run_dir: Path, service: str, default: Level) -> None:
        self._path = run_dir / LEVELS_FILE
        self._service = service
        self._default: Level = default
        self._level: Level = default
        self._seen: tuple[int, int] | None = None

    def look(self) -> None:
        """Take over what the file says now."""
        seen = self._stamp()
        if seen == self._seen:
            return
        self._seen = seen
        levels = read_levels(self._path.parent)
        level = levels.get(self._service, levels.get(ALL, self._default))
        if level != self._level:
            self._level = level
            log.set_level("info")  # the change itself is told at any level
            log.get().info("log.level", to=level)
            log.set_level(level)

    def _stamp(self) -> tuple[int, int] | None:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_ino
