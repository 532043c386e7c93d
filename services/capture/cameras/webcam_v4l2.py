"""What Linux knows of a webcam beyond its pictures: capabilities, modes, controls (V4L2, ``linux/videodev2.h``).

OpenCV streams; it tells neither which modes there are nor why something failed. A second file handle may ask and set
controls while another one streams.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common.errors import CameraError

_VIDEO_CAPTURE = 0x0000_0001
_DEVICE_CAPS = 0x8000_0000
_CAPTURE_BUFFER = 1
_DISCRETE = 1
_NEXT = 0x8000_0000
_DISABLED = 0x0001
_READ_ONLY = 0x0004
_CLASS = 6
_MOST = 256
"""More formats, sizes, rates or controls than this no driver has; one that never ends must not hang us."""


def _request(number: int, layout: str, *, write: bool = True) -> int:
    """The ioctl's number, as ``_IOWR('V', number, layout)`` or ``_IOR`` make it."""
    return (3 if write else 2) << 30 | struct.calcsize(layout) << 16 | ord("V") << 8 | number


_CAPABILITY = "16s32s32sIII3I"
_FORMAT_NAME = "III32sII3I"
_SIZE = "III6I2I"
_RATE = "IIIII6I2I"
_QUERY = "II32siiiiI2I"
_VALUE = "Ii"
_FORMAT = "I4x200s"
_QUERYCAP = _request(0, _CAPABILITY, write=False)
_ENUM_FMT = _request(2, _FORMAT_NAME)
_G_FMT = _request(4, _FORMAT)
_S_FMT = _request(5, _FORMAT)
_G_CTRL = _request(27, _VALUE)
_S_CTRL = _request(28, _VALUE)
_QUERYCTRL = _request(36, _QUERY)
_ENUM_SIZES = _request(74, _SIZE)
_ENUM_RATES = _request(75, _RATE)


@dataclass(frozen=True, slots=True)
class Capability:
    """What a device node is: ``captures`` is False for one that gives metadata or takes pictures."""

    driver: str
    card: str
    bus: str
    captures: bool


@dataclass(frozen=True, slots=True)
class Mode:
    """A pixel format at a size in pixels, with its rates (frames a second, highest first; empty: not told)."""

    fourcc: str
    width: int
    height: int
    rates: tuple[float, ...]

    def __str__(self) -> str:
        """As people read it, e.g. ``MJPG 1280x720 30/15``."""
        return f"{self.fourcc} {self.width}x{self.height} {'/'.join(f'{rate:g}' for rate in self.rates)}".rstrip()


@dataclass(frozen=True, slots=True)
class Control:
    """A setting of the camera; ``name`` is spelled as ``v4l2-ctl`` does (``exposure_time_absolute``)."""

    id: int
    name: str
    minimum: int
    maximum: int
    step: int


class Device:
    """An open device node. Its methods raise OSError as the driver answers."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def capability(self) -> Capability:
        """What this node is."""
        driver, card, bus, _, whole, node, *_ = self._ask(_QUERYCAP, _CAPABILITY, bytes(104))
        caps = node if whole & _DEVICE_CAPS else whole
        return Capability(_text(driver), _text(card), _text(bus), bool(caps & _VIDEO_CAPTURE))

    def refuse_if_busy(self) -> None:
        """Raises OSError EBUSY if another program streams from the camera; else changes nothing."""
        present = fcntl.ioctl(self._handle, _G_FMT, struct.pack(_FORMAT, _CAPTURE_BUFFER, b""))
        fcntl.ioctl(self._handle, _S_FMT, present)

    def modes(self) -> tuple[Mode, ...]:
        """All modes with a fixed size; of a range of sizes its largest."""
        return tuple(
            Mode(_text(struct.pack("I", fourcc)), width, height, tuple(self._rates(fourcc, width, height)))
            for fourcc in self._formats()
            for width, height in self._sizes(fourcc)
        )

    def controls(self) -> dict[str, Control]:
        """All settings that can be changed, by name."""
        found: dict[str, Control] = {}
        last = 0
        for _ in range(_MOST):
            try:
                number, kind, name, low, high, step, _, flags, *_ = self._ask(
                    _QUERYCTRL, _QUERY, struct.pack("I", last | _NEXT)
                )
            except OSError:
                break
            last = number
            if kind != _CLASS and not flags & (_DISABLED | _READ_ONLY):
                spelled = re.sub(r"[^a-z0-9]+", "_", _text(name).lower()).strip("_")
                found[spelled] = Control(number, spelled, low, high, step)
        return found

    def value(self, control: int) -> int:
        """What a setting is at."""
        return int(self._ask(_G_CTRL, _VALUE, struct.pack(_VALUE, control, 0))[1])

    def set(self, control: int, value: int) -> None:
        """Change a setting; the camera may round it."""
        self._ask(_S_CTRL, _VALUE, struct.pack(_VALUE, control, value))

    def _formats(self) -> Iterator[int]:
        for index in range(_MOST):
            try:
                yield self._ask(_ENUM_FMT, _FORMAT_NAME, struct.pack("II", index, _CAPTURE_BUFFER))[4]
            except OSError:
                return

    def _sizes(self, fourcc: int) -> Iterator[tuple[int, int]]:
        for index in range(_MOST):
            try:
                _, _, kind, *numbers = self._ask(_ENUM_SIZES, _SIZE, struct.pack("II", index, fourcc))
            except OSError:
                return
            if kind != _DISCRETE:
                yield numbers[1], numbers[4]
                return
            yield numbers[0], numbers[1]

    def _rates(self, fourcc: int, width: int, height: int) -> Iterator[float]:
        for index in range(_MOST):
            asked = struct.pack("IIII", index, fourcc, width, height)
            try:
                _, _, _, _, kind, numerator, denominator, *_ = self._ask(_ENUM_RATES, _RATE, asked)
            except OSError:
                return
            if numerator:
                yield round(denominator / numerator, 3)
            if kind != _DISCRETE:
                return

    def _ask(self, request: int, layout: str, given: bytes) -> tuple[Any, ...]:
        answer = fcntl.ioctl(self._handle, request, given.ljust(struct.calcsize(layout), b"\0"))
        return struct.unpack(layout, answer)


@contextmanager
def open_device(path: Path) -> Iterator[Device]:
    """The device node at ``path``; raises CameraError with the cure if it can't be opened."""
    try:
        handle = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise CameraError(refusal(path, error)) from error
    try:
        yield Device(handle)
    finally:
        os.close(handle)


def refusal(path: Path, error: OSError) -> str:
    """Why a device refused, in one sentence with the cure."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return (
            f"no permission for {path}: add the user to the group video (sudo usermod -aG video $USER), "
            "then log out and in again"
        )
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"there is no camera at {path}; check its cable (tagmill cameras list shows what is attached)"
    if error.errno == errno.EBUSY:
        return f"{path} is in use{_by_whom(path)}; close that first"
    if error.errno in (errno.ENOTTY, errno.EINVAL):
        return f"{path} is no webcam: it doesn't answer as a video device does"
    return f"{path} can't be used: {os.strerror(error.errno or 0)}"


def _by_whom(path: Path) -> str:
    """The other process that has the device open, as far as this user may see."""
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            opened = {handle.resolve() for handle in (entry / "fd").iterdir()}
            if path.resolve() in opened:
                return f" by {(entry / 'comm').read_text().strip()} (process {entry.name})"
        except OSError:
            continue  # not ours to look into, or gone meanwhile
    return " by another program"


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("utf-8", "replace").strip()
