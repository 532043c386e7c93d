"""Names: of a process's life (boot), of samples, of recordings."""

from __future__ import annotations

import re
import secrets
from datetime import UTC, datetime

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$"
"""What a camera, a session or an object may be called: it becomes part of file names."""

_SAMPLE = re.compile(
    r"(?P<day>\d{8})T(?P<time>\d{6})\.(?P<ms>\d{3})Z-(?P<camera>[A-Za-z0-9][A-Za-z0-9_.-]{0,62})-(?P<frame>\d{1,18})",
    re.ASCII,
)


def new_boot() -> str:
    """A random id of one life of one process, 8 hex digits."""
    return secrets.token_hex(4)


def new_recording(wall: int) -> str:
    """A recording's id: its UTC start time and four random hex digits, e.g. ``rec-20260830T120431-9f3c``."""
    return f"rec-{_compact(wall)}-{secrets.token_hex(2)}"


def sample_name(wall: int, camera: str, frame: int) -> str:
    """A sample's name, e.g. ``20260830T120431.120Z-cam0-48211``.

    ``wall`` is the capture time in ns since the epoch (UTC), ``frame`` the ring's frame number.
    """
    return f"{_compact(wall)}.{wall // 1_000_000 % 1000:03d}Z-{camera}-{frame}"


def is_sample_name(text: str) -> bool:
    """Whether ``text`` is a well-formed sample name (never a path)."""
    return _SAMPLE.fullmatch(text) is not None


def sample_camera(name: str) -> str:
    """The camera in a sample's name; raises ValueError if it is none."""
    return _parts(name)["camera"]


def sample_frame(name: str) -> int:
    """The frame number in a sample's name; raises ValueError if it is none."""
    return int(_parts(name)["frame"])


def sample_captured_at(name: str) -> str:
    """The capture time in a sample's name as ISO 8601 UTC; raises ValueError if it is none."""
    day, time, ms = _parts(name).group("day", "time", "ms")
    return f"{day[:4]}-{day[4:6]}-{day[6:]}T{time[:2]}:{time[2:4]}:{time[4:]}.{ms}Z"


def _parts(name: str) -> re.Match[str]:
    match = _SAMPLE.fullmatch(name)
    if match is None:
        raise ValueError(f"'{name}' is not a sample name")
    return match


def _compact(wall: int) -> str:
    return f"{datetime.fromtimestamp(wall // 1_000_000_000, tz=UTC):%Y%m%dT%H%M%S}"
