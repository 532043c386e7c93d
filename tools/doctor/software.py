"""Versions, OpenCV's build, what is optional, and the clock."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import cv2
from packaging.requirements import Requirement

from common import VERSION, clock
from common.config import Rig
from tools.doctor.finding import Finding, bad, good, warning

EXTRAS = {
    "console": "the operator's web page",
    "fast": "PNG ten times as fast",
    "video": "videos frame by frame, Azure Kinect recordings",
    "bags": "ROS bags",
    "apriltag": "a second detector",
    "locus": "a third detector",
    "realsense": "RealSense cameras",
    "kinect2": "Kinect v2",
    "view": "tagmill view",
    "check": "others' loaders for export",
}
_OLDEST = 1_750_000_000
"""Seconds since the epoch: a clock before that was never set."""
_STA_UNSYNC = 0x0040


def versions(_: Rig | None) -> Iterator[Finding]:
    """Python, tagmill and what it can't do without, each against what tagmill asks for."""
    known = f"tagmill {VERSION}, Python {platform.python_version()}, {platform.machine()}, {platform.system()}"
    if platform.machine() not in {"x86_64", "AMD64"} or sys.platform != "linux":
        yield warning("versions", known, "tagmill is tested on Linux, x86-64; elsewhere run its tests first: make test")
    else:
        yield good("versions", known)
    wrong = []
    for text in requires("tagmill") or []:
        wanted = Requirement(text)
        if wanted.marker is None:
            try:
                found = version(wanted.name)
            except PackageNotFoundError:
                wrong.append(f"{wanted.name} is missing")
                continue
            if not wanted.specifier.contains(found, prereleases=True):
                wrong.append(f"{wanted.name} is {found}, tagmill wants {wanted.specifier}")
    if wrong:
        yield bad("packages", "; ".join(wrong), "make setup (it installs what requirements.lock pins)")
    else:
        yield good("packages", "all as wanted")


def opencv(_: Rig | None) -> Iterator[Finding]:
    """Whether OpenCV is the one tagmill needs, and what it was built with."""
    build = cv2.getBuildInformation()
    found = f"OpenCV {cv2.__version__}"
    if not hasattr(cv2, "aruco"):
        cure = "pip uninstall every opencv package, then pip install opencv-contrib-python-headless"
        yield bad("OpenCV", f"{found} lacks aruco", cure)
        return
    parts = {name: _built_with(build, name) for name in ("FFMPEG", "v4l/v4l2")}
    missing = [name for name, there in parts.items() if not there]
    if missing:
        cure = "videos, streams and webcams need them: pip install opencv-contrib-python-headless"
        yield warning("OpenCV", f"{found} was built without {', '.join(missing)}", cure)
    else:
        yield good("OpenCV", f"{found} with {', '.join(parts)}, {cv2.getNumberOfCPUs()} CPUs seen")


def _built_with(build: str, name: str) -> bool:
    lines = [line for line in build.splitlines() if line.strip().startswith(f"{name}:")]
    return bool(lines) and "YES" in lines[0]


def extras(_: Rig | None) -> Iterator[Finding]:
    """What can be installed in addition."""
    asked = [Requirement(text) for text in requires("tagmill") or []]
    wanted = {name: [one for one in asked if one.marker and one.marker.evaluate({"extra": name})] for name in EXTRAS}
    there = [name for name, packages in wanted.items() if packages and all(_fits(one) for one in packages)]
    lacking = [f"{name} ({what})" for name, what in EXTRAS.items() if name not in there]
    words = f"installed: {', '.join(there) or 'none'}"
    yield good("extras", words + (f"; not: {', '.join(lacking)} - pip install 'tagmill[NAME]'" if lacking else ""))


def _fits(wanted: Requirement) -> bool:
    try:
        return wanted.specifier.contains(version(wanted.name), prereleases=True)
    except PackageNotFoundError:
        return False


def clocks(_: Rig | None) -> Iterator[Finding]:
    """Whether the clock is set and kept: samples are named by it."""
    if clock.wall_ns() / 1e9 < _OLDEST:
        yield bad("clock", f"it is {clock.iso_utc(clock.wall_ns())}", "set the clock: samples are named by it")
        return
    kept = _kept()
    if kept is None:
        yield good("clock", f"{clock.iso_utc(clock.wall_ns())}; whether it is kept can't be seen from here")
    elif kept:
        yield good("clock", f"{clock.iso_utc(clock.wall_ns())}, kept by the network")
    else:
        cure = "timedatectl set-ntp true; names stay unique without it, but times of two machines can't be compared"
        yield warning("clock", f"{clock.iso_utc(clock.wall_ns())}, not synchronised", cure)


def _kept() -> bool | None:
    """What the kernel says (``adjtimex``, whose ``status`` is the sixth machine word); None where it isn't asked."""
    state = (ctypes.c_long * 64)()
    try:
        if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(state)) < 0:
            return None
    except (OSError, AttributeError):
        return None
    status = ctypes.cast(state, ctypes.POINTER(ctypes.c_int))[10]
    in_container = Path("/.dockerenv").exists() or "container" in os.environ
    return None if in_container and status & _STA_UNSYNC else not status & _STA_UNSYNC
