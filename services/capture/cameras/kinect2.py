"""The ``kinect2`` driver: a Kinect v2 through libfreenect2 (pylibfreenect2); see docs/how-to/kinect-v2.md.

The library's open gives a broken object when it fails, whose next call kills the process. So a camera is looked for
before it is opened, and what happens nevertheless is told by the next process (``last_life``).
"""

from __future__ import annotations

from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import pylibfreenect2 as freenect2

from common import clock
from common.config import Rig
from common.config.models import CameraConfig, Kinect2Options
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import Attached, Description, Grabbed
from services.capture.cameras.intrinsics import known_or_factory
from services.capture.cameras.kinect2_frames import (
    HEIGHT,
    WIDTH,
    TickClock,
    camera_model,
    colour_picture,
    depth_picture,
    lateness_ms,
)
from services.capture.cameras.options import read_options

FPS = 30.0
FIRST_FRAME_S = 8.0
"""A start that failed shows only in that no frame ever comes; on a slow machine the first takes seconds."""
WAIT_MS = 200
JUDGED_FRAMES = 30
LATE_MS = 20.0
_DEPTH_SIZE = (512, 424, 4)
_BIG_DEPTH_SIZE = (WIDTH, HEIGHT + 2, 4)
_PIPELINES = {"cpu": "CpuPacketPipeline", "opengl": "OpenGLPacketPipeline", "opencl": "OpenCLPacketPipeline"}


def attached() -> list[Attached]:
    """The Kinects that can be opened; the library passes over those that it has no permission for."""
    modes = (f"colour {WIDTH}x{HEIGHT} 30", "depth 512x424 30")
    return [Attached("kinect2", "Kinect v2", _text(serial), modes=modes) for serial in _serials(_library())]


class Kinect2Camera:
    """See ``Kinect2Options`` for its keys. Colour is 1920x1080, or smaller by ``width``; depth in mm, aligned to it.

    Raises ConfigError, CameraError as a driver does.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig) -> None:
        self._name = name
        options = read_options(name, config, Kinect2Options)
        self._width, self._height = _size(name, config)
        self._library = _library()
        self._serial = _chosen(name, _serials(self._library), options.serial)
        self._device: Any = self._library.openDevice(self._serial, pipeline=_pipeline(name, options.pipeline))
        kinds = freenect2.FrameType.Color | freenect2.FrameType.Ir | freenect2.FrameType.Depth
        self._listener = freenect2.SyncMultiFrameListener(kinds)
        self._device.setColorFrameListener(self._listener)
        self._device.setIrAndDepthFrameListener(self._listener)
        self._device.start()
        try:
            self._wait_first()
            colour = self._device.getColorCameraParams()
            self._registration = freenect2.Registration(self._device.getIrCameraParams(), colour)
            factory = camera_model(colour, self._width, self._height)
            camera, warnings = known_or_factory(name, rig.calibration(name), factory, _text(self._serial))
        except (CameraError, ConfigError):
            self.close()
            raise
        self._undistorted = freenect2.Frame(*_DEPTH_SIZE)
        self._registered = freenect2.Frame(*_DEPTH_SIZE)
        self._big_depth = freenect2.Frame(*_BIG_DEPTH_SIZE)
        self._clock = TickClock()
        self._lateness: list[float] = []
        self._description = Description(
            camera, config.fps or FPS, depth_unit_mm=1.0, stamps="device", warnings=warnings
        )

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera."""
        if self._device is None:
            raise CameraError(f"camera {self._name} is closed")
        frames = self._listener.waitForNewFrame(milliseconds=max(1, int(timeout_s * 1000)))
        if frames is None:
            raise self._silence()
        try:
            return self._taken(frames[freenect2.FrameType.Color], frames[freenect2.FrameType.Depth])
        finally:
            self._listener.release(frames)

    def describe(self) -> Description:
        """See Camera."""
        return self._description

    def close(self) -> None:
        """See Camera."""
        device, self._device = self._device, None
        if device is not None:
            device.stop()
            device.close()

    def _wait_first(self) -> None:
        deadline = clock.monotonic_ns() + int(FIRST_FRAME_S * 1e9)
        while clock.monotonic_ns() < deadline:
            frames = self._listener.waitForNewFrame(milliseconds=WAIT_MS)
            if frames is not None:
                self._listener.release(frames)
                return
        raise CameraError(
            f"the Kinect v2 {_text(self._serial)} was opened but gave no frame within {FIRST_FRAME_S:g} s: it could "
            "not be started; check its power supply and that it is on a USB 3 port of its own"
        )

    def _taken(self, colour: Any, depth: Any) -> Grabbed:
        """Copies of the frames, whose memory is the library's until they are released."""
        self._registration.apply(colour, depth, self._undistorted, self._registered, bigdepth=self._big_depth)
        self._judge(lateness_ms(colour.timestamp, depth.timestamp))
        return Grabbed(
            bgr=colour_picture(colour.asarray(np.uint8), self._width, self._height),
            depth=depth_picture(self._big_depth.asarray(np.float32), self._width, self._height),
            device_ns=self._clock.ns(colour.timestamp),
        )

    def _silence(self) -> TimeoutError | CameraError:
        """Why no frame came: unplugged, or only late (the grabber decides when that is a stall)."""
        if self._serial in _serials(self._library):
            return TimeoutError(f"{self._name}: the Kinect v2 is attached but gave no frame in time")
        return CameraError(f"the Kinect v2 {_text(self._serial)} is unplugged or has lost its power")

    def _judge(self, late_ms: float) -> None:
        """Say once by how much colour and depth are apart: the library pairs them by arrival, not by time."""
        if len(self._lateness) >= JUDGED_FRAMES:
            return
        self._lateness.append(late_ms)
        middle = median(self._lateness)
        if len(self._lateness) == JUDGED_FRAMES and abs(middle) >= LATE_MS:
            told = (
                f"colour is taken {middle:.0f} ms after the depth it comes with (median of {JUDGED_FRAMES} frames): "
                "what moves has its depth elsewhere; a faster `pipeline` (opengl, opencl) brings them together"
            )
            known = self._description
            self._description = replace(known, warnings=(*known.warnings, told))


def _library() -> Any:
    """The library; what it would tell on stdout at every start is left out, warnings stay."""
    freenect2.setGlobalLogger(freenect2.createConsoleLogger(freenect2.LoggerLevel.Warning))
    return freenect2.Freenect2()


def _serials(library: Any) -> list[bytes]:
    """Bytes, as the library has them."""
    return [library.getDeviceSerialNumber(index) for index in range(library.enumerateDevices())]


def _chosen(name: str, found: list[bytes], wanted: str | None) -> bytes:
    """The serial of the camera to open; CameraError if it isn't there."""
    if not found:
        raise CameraError(
            f"camera {name}: no Kinect v2 is attached (or none that may be opened); check its power supply, the "
            "USB 3 port, and the udev rule of libfreenect2"
        )
    if wanted is None:
        return found[0]
    if wanted.encode() not in found:
        there = ", ".join(map(_text, found))
        raise CameraError(f"camera {name}: no Kinect v2 of serial {wanted} is attached; there is {there}")
    return wanted.encode()


def _text(serial: bytes) -> str:
    return serial.decode("ascii", "replace")


def _pipeline(name: str, wanted: str) -> Any:
    made = getattr(freenect2, _PIPELINES[wanted], None)
    if made is None:
        raise ConfigError(
            f"cameras.{name}.pipeline: this libfreenect2 was built without {wanted}; use `pipeline: cpu`, or build it "
            f"with {wanted} and install pylibfreenect2 anew"
        )
    return made()


def _size(name: str, config: CameraConfig) -> tuple[int, int]:
    """The picture's size: 1920x1080, or what ``width`` or ``height`` makes of it."""
    width = config.width or (WIDTH if config.height is None else config.height * WIDTH // HEIGHT)
    height = config.height or width * HEIGHT // WIDTH
    if width > WIDTH or width * HEIGHT != height * WIDTH:
        raise ConfigError(
            f"cameras.{name}: a Kinect v2 gives {WIDTH}x{HEIGHT} or that scaled down, e.g. 1280x720 or 960x540, "
            f"not {width}x{height}"
        )
    return width, height
