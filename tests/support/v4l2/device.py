"""A webcam for tests: the file that device.c, preloaded, answers for as the kernel would."""

from __future__ import annotations

import ctypes
import functools
import mmap
import os
import struct
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

SOURCE = Path(__file__).with_name("device.c")
FOLDER = "TAGMILL_TEST_V4L2"
MAGIC = 0x56344C32
CAPTURE = 0x04000001
"""Video capture and streaming; a camera's second node, for metadata, is 0x04800000."""
METADATA = 0x04800000

EXPOSURE_AUTO, EXPOSURE, FOCUS_AUTO, FOCUS = 0x009A0901, 0x009A0902, 0x009A090C, 0x009A090A
BALANCE_AUTO, BALANCE, GAIN, POWER_LINE = 0x0098090C, 0x0098091A, 0x00980913, 0x00980918
INTEGER, BOOLEAN, MENU = 1, 2, 3
PICTURES = 8
"""So many different pictures a mode has; the n-th is of grey ``20 + 25 n``."""


class Mode(ctypes.Structure):
    _fields_ = [
        ("fourcc", ctypes.c_uint32),
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("fps", ctypes.c_uint32 * 4),
    ]


class Control(ctypes.Structure):
    _fields_ = [
        ("id", ctypes.c_uint32),
        ("type", ctypes.c_uint32),
        ("minimum", ctypes.c_int32),
        ("maximum", ctypes.c_int32),
        ("step", ctypes.c_int32),
        ("standard", ctypes.c_int32),
        ("value", ctypes.c_int32),
        ("flags", ctypes.c_uint32),
        ("name", ctypes.c_char * 32),
    ]


_NUMBERS = (
    "magic plugged stalled frozen cut open_errno format_errno start_errno streaming capabilities least_buffers "
    "mode_count control_count fourcc width height fps starts pictures stamp_offset_s"
)


class State(ctypes.Structure):
    """``struct device`` of device.c."""

    _fields_ = [
        *((name, ctypes.c_uint32) for name in _NUMBERS.split()),
        ("card", ctypes.c_char * 32),
        ("bus", ctypes.c_char * 32),
        ("modes", Mode * 12),
        ("controls", Control * 12),
    ]


CONTROLS = (
    (EXPOSURE_AUTO, MENU, 0, 3, 1, 3, "Auto Exposure"),
    (EXPOSURE, INTEGER, 3, 2047, 1, 250, "Exposure Time, Absolute"),
    (FOCUS_AUTO, BOOLEAN, 0, 1, 1, 1, "Focus, Automatic Continuous"),
    (FOCUS, INTEGER, 0, 250, 5, 0, "Focus, Absolute"),
    (BALANCE_AUTO, BOOLEAN, 0, 1, 1, 1, "White Balance, Automatic"),
    (BALANCE, INTEGER, 2000, 6500, 1, 4000, "White Balance Temperature"),
    (GAIN, INTEGER, 0, 255, 1, 0, "Gain"),
    (POWER_LINE, MENU, 0, 2, 1, 2, "Power Line Frequency"),
)
MODES = (("MJPG", 1280, 720, (30,)), ("MJPG", 640, 480, (30, 15)), ("YUYV", 640, 480, (30,)), ("MJPG", 64, 48, (100,)))


def fourcc(word: str) -> int:
    return int.from_bytes(word.encode(), "little")


class Webcam:
    """Makes the file ``path`` and what lies beside it; attributes of ``state`` act at once on who has it open."""

    def __init__(
        self,
        path: Path,
        modes: Iterable[tuple[str, int, int, tuple[int, ...]]] = MODES,
        controls: Iterable[tuple[int, int, int, int, int, int, str]] = CONTROLS,
        capabilities: int = CAPTURE,
    ) -> None:
        self.path = path
        self._modes = tuple(modes)
        self._controls = tuple(controls)
        self._capabilities = capabilities
        self.plug_in()

    def plug_in(self) -> None:
        """The device as it comes from the shop."""
        state = State(magic=MAGIC, plugged=1, capabilities=self._capabilities, least_buffers=1)
        state.card, state.bus = b"Test Cam: HD", b"usb-0000:00:14.0-2"
        state.mode_count, state.control_count = len(self._modes), len(self._controls)
        for made, (word, width, height, rates) in zip(state.modes, self._modes, strict=False):
            made.fourcc, made.width, made.height = fourcc(word), width, height
            made.fps[: len(rates)] = rates
            if word == "MJPG":
                self._write_pictures(width, height)
        for control, (number, kind, low, high, step, standard, name) in zip(
            state.controls, self._controls, strict=False
        ):
            control.id, control.type, control.name = number, kind, name.encode()
            control.minimum, control.maximum, control.step = low, high, step
            control.standard = control.value = standard
        state.fourcc, state.width, state.height, state.fps = fourcc("YUYV"), 640, 480, 30
        self.path.write_bytes(bytes(state))
        self.state = state_of(self.path)

    def unplug(self) -> None:
        """Pull the cable."""
        self.state.plugged = 0
        self.path.unlink()

    def value(self, control: int) -> int:
        """What a control is set to."""
        return next(int(one.value) for one in self.state.controls if one.id == control)

    def _write_pictures(self, width: int, height: int) -> None:
        jpegs = [
            cv2.imencode(".jpg", np.full((height, width, 3), 20 + 25 * number, np.uint8))[1].tobytes()
            for number in range(PICTURES)
        ]
        parts = b"".join(struct.pack("<I", len(jpeg)) + jpeg for jpeg in jpegs)
        Path(f"{self.path}.{width}x{height}.mjpg").write_bytes(parts)


def state_of(path: Path) -> State:
    """The live state of the webcam at ``path``."""
    with path.open("r+b") as file:
        return State.from_buffer(mmap.mmap(file.fileno(), ctypes.sizeof(State)))


@functools.cache
def _workshop() -> tempfile.TemporaryDirectory[str]:
    """A folder of our own for the library: nobody else can put one there. Gone when this process ends."""
    return tempfile.TemporaryDirectory(prefix="tagmill-v4l2-")


@functools.cache
def library() -> Path:
    """device.c, compiled."""
    made = Path(_workshop().name) / "device.so"
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    command = [os.environ.get("CC") or "gcc", *flags, str(SOURCE), "-o", str(made), "-ldl", "-lpthread"]
    subprocess.run(command, check=True, timeout=60)
    return made


def preloaded(folder: Path) -> dict[str, str]:
    """The environment of a process in which the files below ``folder`` are webcams."""
    return {**os.environ, "LD_PRELOAD": str(library()), FOLDER: str(folder.resolve())}


def is_preloaded() -> bool:
    """Whether this process is such a one."""
    return FOLDER in os.environ


def folder() -> Path:
    """Where webcams can be made in a preloaded process."""
    return Path(os.environ[FOLDER])
