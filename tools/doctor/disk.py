"""Where samples go: room, speed, what fsync costs; and the run folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from common.bus import Endpoints
from common.clock import monotonic_ns
from common.config import Rig, RigConfig
from common.errors import ConfigError
from tools.doctor.finding import Finding, bad, good, warning

_SAMPLE_MB = 2.3
"""A 1280x720 sample with depth as PNG, about."""
_LEAST_FREE = 2e9
_PIECE = b"\xa5" * (1 << 20)
_PIECES = 32
_PROBE_S = 2.0
_SLOW_MB_S, _SLOW_FSYNC_MS = 50.0, 30.0


def dataset(rig: Rig | None) -> Iterator[Finding]:
    """The disk of the rig's dataset, else that of this folder; writes 32 MB there and removes them."""
    folder = _existing(rig.dataset_root if rig is not None else Path.cwd())
    free = shutil.disk_usage(folder).free
    words = f"{folder}: {free / 1e9:.1f} GB free, about {free / 1e6 / _SAMPLE_MB:,.0f} samples of 1280x720 with depth"
    yield good("disk", words) if free >= _LEAST_FREE else warning("disk", words, "free some, or choose dataset.root")
    try:
        rate, fsync_ms = probe(folder)
    except OSError as error:
        yield bad("disk speed", f"{folder} can't be written: {error.strerror}", "choose another dataset.root")
        return
    words = f"{rate:.0f} MB/s, fsync of a small file {fsync_ms:.1f} ms"
    if rate < _SLOW_MB_S or fsync_ms > _SLOW_FSYNC_MS:
        cure = "each sample is fsynced before it is acknowledged; a local SSD records at full rate, this disk may not"
        yield warning("disk speed", words, cure)
    else:
        yield good("disk speed", words)


def probe(folder: Path) -> tuple[float, float]:
    """MB/s written and fsynced, and the median ms of an fsync of 4 KiB, in ``folder``; within 2 s. Raises OSError."""
    with tempfile.TemporaryFile(dir=folder) as file:
        descriptor = file.fileno()
        begin = monotonic_ns()
        written = 0
        while written < _PIECES * len(_PIECE) and monotonic_ns() - begin < _PROBE_S * 1e9 / 2:
            written += os.write(descriptor, _PIECE)
        os.fsync(descriptor)
        rate = written / 1e6 / ((monotonic_ns() - begin) / 1e9)
        times: list[int] = []
        begin = monotonic_ns()
        while len(times) < 9 and monotonic_ns() - begin < _PROBE_S * 1e9 / 2:
            before = monotonic_ns()
            os.pwrite(descriptor, _PIECE[:4096], 0)
            os.fsync(descriptor)
            times.append(monotonic_ns() - before)
    return rate, sorted(times)[len(times) // 2] / 1e6


def run_folder(rig: Rig | None) -> Iterator[Finding]:
    """Whether the sockets can be where they belong, and nobody else may reach them."""
    try:
        endpoints = Endpoints.of((rig.config if rig is not None else RigConfig()).network)
        endpoints.prepare()
    except ConfigError as error:
        yield bad("run folder", error.message, "set TAGMILL_RUN_DIR to a short path in a folder of yours")
        return
    yield good("run folder", f"{endpoints.run_dir}, open to this user only")
    if os.getuid() == 0:
        cure = "a stack needs no rights of root: run it as a user in the groups video and plugdev"
        yield warning("user", "this is root", cure)


def _existing(folder: Path) -> Path:
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    return folder
