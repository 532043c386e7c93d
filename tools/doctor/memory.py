"""Shared memory, limits of this user, and what earlier stacks left."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator

import psutil

from common.bus import Endpoints
from common.config import Rig, RigConfig
from common.frames import shm_folder
from tools.doctor.finding import Finding, bad, good, warning
from tools.stack.leftovers import living, remains

ABOUT = "shared memory"
_MB = 1e6
_COLOUR, _DEPTH = 3, 2
_DEFAULT_SIZE = (1280, 720)
_FILES_A_PROCESS = 1024
_PROCESSES = 256


def shared_memory(rig: Rig | None) -> Iterator[Finding]:
    """Whether the rings of the rig (or of one 1280x720 depth camera) fit."""
    folder = shm_folder()
    try:
        total, _, free = shutil.disk_usage(folder)
    except OSError as error:
        yield bad(ABOUT, f"{folder} can't be looked at: {error.strerror}", "pixels travel there; mount a tmpfs on it")
        return
    need = ring_bytes(rig.config if rig is not None else RigConfig())
    what = "this rig" if rig is not None else "one 1280x720 camera with depth"
    sizes = f"{folder} has {free / _MB:.0f} of {total / _MB:.0f} MB free; {what} needs up to {need / _MB:.0f} MB"
    if free >= need:
        yield good(ABOUT, sizes)
    else:
        wanted = -(-(total - free + need) // (64 << 20)) * 64
        mount = f"mount -o remount,size={wanted}m {folder} (Docker: --shm-size={wanted}m)"
        cure = f"{mount}, or fewer ring.slots and ring.samples in the rig file"
        yield bad(ABOUT, sizes, cure)


def ring_bytes(config: RigConfig) -> int:
    """What the frame and sample rings of all cameras take, in bytes; sizes that aren't given count as 1280x720."""
    sizes = [
        (camera.width or _DEFAULT_SIZE[0], camera.height or _DEFAULT_SIZE[1]) for camera in config.cameras.values()
    ]
    pixels = sum(width * height for width, height in sizes or [_DEFAULT_SIZE])
    original = _COLOUR if config.dataset.keep_original else 0
    slot, sample = _COLOUR + _DEPTH, _COLOUR + _DEPTH + original
    return pixels * (slot * config.ring.slots + sample * config.ring.samples)


def limits(_: Rig | None) -> Iterator[Finding]:
    """Open files and processes."""
    wanted = {"open files (ulimit -n)": (resource.RLIMIT_NOFILE, _FILES_A_PROCESS)}
    wanted["processes (ulimit -u)"] = (resource.RLIMIT_NPROC, _PROCESSES)
    for about, (which, least) in wanted.items():
        soft, hard = resource.getrlimit(which)
        words = "unlimited" if soft == resource.RLIM_INFINITY else str(soft)
        if soft == resource.RLIM_INFINITY or soft >= least:
            yield good(about, words)
        else:
            letter = about[-2]
            room = "" if hard == resource.RLIM_INFINITY or hard >= least else "; raise it in /etc/security/limits.conf"
            yield warning(about, f"{words}, a stack wants {least}", f"ulimit -{letter} {least}{room}")


def main_memory(_: Rig | None) -> Iterator[Finding]:
    """Main memory and cores."""
    available = psutil.virtual_memory().available
    words = f"{available / 1e9:.1f} GB available, {len(os.sched_getaffinity(0))} cores"
    if available < 1.5e9:
        yield warning("memory", words, "a stack takes about 1.5 GB with one camera; close something, or add memory")
    else:
        yield good("memory", words)


def leftovers(rig: Rig | None) -> Iterator[Finding]:
    """A stack that runs, or what a killed one left."""
    endpoints = Endpoints.of((rig.config if rig is not None else RigConfig()).network)
    running = living(endpoints)
    if running:
        yield good("leftovers", f"a stack runs as '{endpoints.prefix}': {', '.join(running)}")
        return
    left = remains(endpoints)
    if left:
        some = ", ".join(left[:5]) + (f" and {len(left) - 5} more" if len(left) > 5 else "")
        yield warning("leftovers", f"a killed stack left {some}", "tagmill down removes it (and so does the next up)")
    else:
        yield good("leftovers", "none")
