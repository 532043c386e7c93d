"""What a check found."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from common.config import Rig

Level = Literal["good", "warning", "bad"]
"""``warning``: it runs, but not as well as it could; ``bad``: a stack won't start, or won't record."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's: what was looked at, how it is, and what to do about it (empty where it is good)."""

    about: str
    level: Level
    found: str
    cure: str = ""


def good(about: str, found: str) -> Finding:
    """All is well."""
    return Finding(about, "good", found)


def warning(about: str, found: str, cure: str) -> Finding:
    """Something could be better."""
    return Finding(about, "warning", found, cure)


def bad(about: str, found: str, cure: str) -> Finding:
    """Something keeps a stack from its work."""
    return Finding(about, "bad", found, cure)


Check = Callable[[Rig | None], Iterable[Finding]]
"""With the rig that shall run, if one was named and can be read."""
