"""Mistakes in a configuration file: collected, placed on their line, told all at once."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from common.errors import ConfigError

FieldPath = tuple[str | int, ...]


def field_name(path: FieldPath) -> str:
    """A path as a person reads it: ``objects[0].sides.front.marker``; empty for the file as a whole."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def suggestion(word: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` if a known word is near, else an empty text."""
    table = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), table, n=1, cutoff=0.6)
    return f"; did you mean '{table[near[0]]}'?" if near else ""


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake. ``line`` counts from 1, 0 = the file as a whole."""

    file: Path
    line: int
    path: FieldPath
    reason: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else str(self.file)
        field = field_name(self.path)
        return f"{place}: {field}: {self.reason}" if field else f"{place}: {self.reason}"


class Problems:
    """The mistakes of one file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.found: list[Problem] = []

    def add(self, line: int, path: FieldPath, reason: str) -> None:
        """Note a mistake; a second one about the same field with the same reason is not repeated."""
        problem = Problem(self.file, line, path, reason)
        if problem not in self.found:
            self.found.append(problem)

    def touch(self, path: FieldPath) -> bool:
        """Whether a mistake was found at ``path`` or below it."""
        return any(problem.path[: len(path)] == path for problem in self.found)

    def lines(self) -> tuple[str, ...]:
        """Each mistake as ``file:line: field: reason``, from the top of the file to its end."""
        return tuple(str(problem) for problem in sorted(self.found, key=lambda one: one.line))

    def raise_if_any(self) -> None:
        """Raise ConfigError with all of them."""
        lines = self.lines()
        if len(lines) == 1:
            raise ConfigError(lines[0], lines)
        if lines:
            raise ConfigError(f"{self.file} has {len(lines)} mistakes:\n" + "\n".join(lines), lines)
