"""A player of recorded arrays with pylibfreenect2's face, where the real one can't be built (see hardware facts).

As the real one: serials are bytes; an open that fails gives an object whose next call kills the process; `start`
says nothing; a wait gives None after its time; frames are gone once they are released; all pictures are mirrored.
"""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np


class FrameType(IntEnum):
    Color = 1
    Ir = 2
    Depth = 4


class LoggerLevel(IntEnum):
    Warning = 2


@dataclass
class Script:
    """What is attached and what it plays: (colour, big depth, colour ticks, depth ticks) each."""

    attached: list[bytes] = field(default_factory=lambda: [b"0815"])
    opens: bool = True
    frames: list[tuple[np.ndarray, np.ndarray, int, int]] = field(default_factory=list)
    opened: list[tuple[bytes, str]] = field(default_factory=list)
    held: int = 0
    closed: int = 0


SCRIPT = Script()


class Params:
    fx = fy = 1081.37
    cx, cy = 959.5, 539.5


def createConsoleLogger(level):  # noqa: N802 - the library's names
    return level


def setGlobalLogger(logger):  # noqa: N802
    assert logger == LoggerLevel.Warning


class CpuPacketPipeline:
    pass


class Frame:
    def __init__(self, width, height, bytes_per_pixel, data=None, ticks=0):
        self.timestamp = ticks
        self.data = np.zeros((height, width), np.float32) if data is None else data
        assert bytes_per_pixel == 4

    def asarray(self, dtype=None):
        assert dtype == self.data.dtype
        return self.data


class SyncMultiFrameListener:
    def __init__(self, kinds):
        assert kinds == 7

    def waitForNewFrame(self, milliseconds=None):  # noqa: N802
        assert isinstance(milliseconds, int)
        assert SCRIPT.held == 0, "frames that are not released stall the stream"
        if not SCRIPT.frames:
            time.sleep(milliseconds / 1000)
            return None
        colour, big_depth, colour_ticks, depth_ticks = SCRIPT.frames.pop(0)
        SCRIPT.held += 1
        return {
            FrameType.Color: Frame(1920, 1080, 4, colour.copy(), colour_ticks),
            FrameType.Depth: Frame(512, 424, 4, big_depth, depth_ticks),
        }

    def release(self, frames):
        frames[FrameType.Color].data[:] = 0xAA
        SCRIPT.held -= 1


class Registration:
    def __init__(self, ir, colour):
        assert isinstance(ir, Params)

    def apply(self, colour, depth, undistorted, registered, enable_filter=True, bigdepth=None):
        assert SCRIPT.held == 1
        bigdepth.data[:] = depth.data


class Device:
    def __init__(self, broken):
        self._broken = broken
        self._started = False

    def __getattribute__(self, name):
        if name != "_broken" and self._broken:
            os.kill(os.getpid(), signal.SIGSEGV)
        return object.__getattribute__(self, name)

    def setColorFrameListener(self, listener):  # noqa: N802
        pass

    def setIrAndDepthFrameListener(self, listener):  # noqa: N802
        pass

    def start(self):
        self._started = True

    def getColorCameraParams(self):  # noqa: N802
        assert self._started
        return Params()

    def getIrCameraParams(self):  # noqa: N802
        assert self._started
        return Params()

    def stop(self):
        self._started = False

    def close(self):
        SCRIPT.closed += 1


class Freenect2:
    def enumerateDevices(self):  # noqa: N802
        return len(SCRIPT.attached)

    def getDeviceSerialNumber(self, index):  # noqa: N802
        return SCRIPT.attached[index]

    def openDevice(self, serial, pipeline=None):  # noqa: N802
        SCRIPT.opened.append((serial, type(pipeline).__name__))
        return Device(broken=not SCRIPT.opens or serial not in SCRIPT.attached)
