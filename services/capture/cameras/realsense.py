"""The ``realsense`` driver: Intel RealSense cameras, and recordings of them, through pyrealsense2."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common import clock
from common.config import Rig
from common.config.models import CameraConfig
from common.config.realsense import RealSenseOptions
from common.errors import CameraError, ConfigError
from common.labels import CameraLabel
from services.capture.cameras.base import Attached, Description, EndOfStreamError, Grabbed, Stamps
from services.capture.cameras.intrinsics import known_or_factory
from services.capture.cameras.options import read_options
from services.capture.cameras.pacing import Pacer
from services.capture.cameras.realsense_alignment import DepthAligner
from services.capture.cameras.realsense_geometry import camera_model
from services.capture.cameras.realsense_modes import COLOUR_FORMATS, DEPTH_FORMATS, Wish, modes_of, summary
from services.capture.cameras.realsense_sdk import (
    camera_error,
    info_of,
    on_usb_2,
    rs,
    title_of,
)
from services.capture.cameras.realsense_settings import apply_settings
from services.capture.cameras.realsense_streams import LiveStream, Pair, RecordedStream, Stream

COVERED = 0.97
"""Warn if fewer of the picture's pixels than this can have a depth at all."""
TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "yuyv": cv2.COLOR_YUV2BGR_YUYV,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
}


class RealSenseCamera:
    """See ``RealSenseOptions`` for its keys. Raises ConfigError, CameraError as a driver does.

    A recording behaves like the ``files`` driver's video: it waits for a recording order unless it loops or begins
    at start. ``context``: the SDK's, with its devices, in place of one of the driver's own.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig, context: Any | None = None) -> None:
        self._name = name
        self._config = config
        self._options = read_options(name, config, RealSenseOptions)
        self._calibration = rig.calibration(name)
        self._recording = None if self._options.recording is None else rig.resolve(self._options.recording)
        preset = self._options.preset_file
        self._preset_file = None if preset is None else rig.resolve(preset)
        self._context = context
        self._stream: Stream | None = None
        self._delivered = 0
        self._newest_ns = 0
        self._earlier_loops_ns = 0
        self._wall_ahead_ns = 0
        try:
            self._open()
        except ConfigError as error:
            self.close()
            raise ConfigError(f"camera {name}: {error.message}") from error
        except CameraError:
            self.close()
            raise
        except RuntimeError as error:
            self.close()
            raise camera_error(f"camera {name} can't be opened", error) from error

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera."""
        if self._pacer is not None and not self._pacer.wait(timeout_s):
            raise TimeoutError(f"{self._name}: the next frame is due later")
        pair = self._next(timeout_s)
        try:
            bgr = _bgr(pair.colour)
            depth = None if self._aligner is None else self._aligner.align(pair.frameset)
        except RuntimeError as error:
            raise camera_error(f"camera {self._name} gave a frame that can't be used", error) from error
        number, self._delivered = self._delivered, self._delivered + 1
        if self._recording is None:
            return Grabbed(bgr, depth, self._stamp(pair.colour), missed=pair.missed)
        self._newest_ns = self._earlier_loops_ns + int(pair.colour.get_timestamp() * 1e6)
        return Grabbed(bgr, depth, self._newest_ns, f"{self._recording.name}#{number}", missed=pair.missed)

    def describe(self) -> Description:
        """See Camera."""
        return self._description

    def rewind(self, frame: int = 0) -> None:
        """See Rewindable; a recording is opened anew and read up to ``frame``: seeking in it is not exact."""
        if self._recording is None:
            raise CameraError(f"camera {self._name} is live; it can't begin again")
        self._reopen()
        self._earlier_loops_ns = 0
        if self._pacer is not None:
            self._pacer.restart()
        try:
            while self._delivered < frame:
                self._opened().next(5.0)
                self._delivered += 1
        except EndOfStreamError:
            return  # the next grab says so

    def close(self) -> None:
        """See Camera."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def _open(self) -> None:
        options, config = self._options, self._config
        if self._recording is not None:
            wish = Wish(config.width, config.height, None, options.depth)
            stream: Stream = RecordedStream(self._recording, wish)
            self._stream = stream
        else:
            wish = Wish(config.width, config.height, config.fps, options.depth, options.depth_size)
            live = LiveStream(self._context or rs.context(), options.serial, wish)
            self._stream = stream = live
            depth_sensor = None if live.depth is None else live.depth.sensor
            apply_settings(live.device, live.colour.sensor, depth_sensor, options, self._preset_file)
            live.start()
        fps = (self._recording and config.fps) or float(stream.colour.fps)
        self._pacer = Pacer(fps) if self._recording is not None and options.pace == "fps" else None
        unit_mm = None if stream.depth is None else _unit_mm(stream.depth.sensor)
        self._aligner = None
        if stream.depth is not None and unit_mm is not None:
            self._aligner = DepthAligner(stream.colour.profile, stream.depth.profile, unit_mm)
        self._description = self._describe(stream, fps, unit_mm)

    def _describe(self, stream: Stream, fps: float, unit_mm: float | None) -> Description:
        camera, warnings = self._intrinsics(stream)
        if self._recording is None and on_usb_2(stream.device):
            warnings.append(f"the {title_of(stream.device)} is on USB 2: few modes, low rates; use a USB 3 port")
        if self._aligner is not None and self._aligner.coverage < COVERED:
            warnings.append(
                f"camera {self._name}: only {self._aligner.coverage:.0%} of the picture can have depth, "
                "because its lens bends the rest out of reach of the SDK's alignment"
            )
        played = self._recording is not None
        return Description(
            camera=camera,
            fps=fps,
            depth_unit_mm=unit_mm,
            paced=played and self._options.pace == "consumer",
            waits_for_start=played and not self._options.loop and self._options.begin == "on_start",
            stamps="media" if played else "device",
            warnings=tuple(warnings),
        )

    def _intrinsics(self, stream: Stream) -> tuple[CameraLabel, list[str]]:
        serial = info_of(stream.device, rs.camera_info.serial_number) or None
        factory = camera_model(stream.colour.profile.get_intrinsics())
        label, warnings = known_or_factory(self._name, self._calibration, factory, serial)
        return label, list(warnings)

    def _next(self, timeout_s: float) -> Pair:
        try:
            return self._opened().next(timeout_s)
        except EndOfStreamError:
            if not self._options.loop:
                raise
        self._earlier_loops_ns = self._newest_ns + int(1e9 / self._description.fps)
        self._reopen()
        first = self._opened().next(timeout_s)
        self._earlier_loops_ns -= int(first.colour.get_timestamp() * 1e6)
        return first

    def _reopen(self) -> None:
        assert self._recording is not None
        self._opened().close()
        self._stream = RecordedStream(
            self._recording, Wish(self._config.width, self._config.height, None, self._options.depth)
        )
        self._delivered = 0

    def _opened(self) -> Stream:
        if self._stream is None:
            raise CameraError(f"camera {self._name} is closed")
        return self._stream

    def _stamp(self, colour: Any) -> int:
        """The frame's ``device_ns``, and the description says of which clock it is.

        In the domains ``global_time`` and ``system_time`` the SDK has mapped the camera's clock to the host's wall
        clock; that is taken over (with its global time on, the SDK asks the camera for its time again and again).
        """
        stamp_ns = int(colour.get_timestamp() * 1e6)
        mapped = colour.get_frame_timestamp_domain() != rs.timestamp_domain.hardware_clock
        stamps: Stamps = "monotonic" if mapped else "device"
        if stamps != self._description.stamps:
            self._description = replace(self._description, stamps=stamps)
            self._wall_ahead_ns = clock.wall_ns() - clock.monotonic_ns()
        return stamp_ns - self._wall_ahead_ns if mapped else stamp_ns


def attached() -> list[Attached]:
    """The RealSense cameras that are attached; see Attached. Opens none."""
    try:
        return [_attached(device) for device in rs.context().query_devices()]
    except RuntimeError as error:
        raise camera_error("the RealSense cameras can't be listed", error) from error


def _attached(device: Any) -> Attached:
    notes = []
    if on_usb_2(device):
        notes.append("on USB 2: few modes, low rates; use a USB 3 port")
    firmware = info_of(device, rs.camera_info.firmware_version)
    wanted = info_of(device, rs.camera_info.recommended_firmware_version)
    if firmware and wanted and _numbers(firmware) < _numbers(wanted):
        notes.append(f"firmware {firmware} is older than the recommended {wanted}")
    modes = [
        f"{what} {width}x{height} {max(rates)}"
        for what, stream, formats in (
            ("colour", rs.stream.color, COLOUR_FORMATS),
            ("depth", rs.stream.depth, DEPTH_FORMATS),
        )
        for (width, height), rates in summary(modes_of(device, stream, formats)).items()
    ]
    return Attached(
        driver="realsense",
        name=" ".join(filter(None, [info_of(device, rs.camera_info.name), firmware and f"(firmware {firmware})"])),
        serial=info_of(device, rs.camera_info.serial_number),
        address=info_of(device, rs.camera_info.physical_port),
        modes=tuple(modes),
        note="; ".join(notes),
    )


def _numbers(version: str) -> list[int]:
    return [int(part) for part in version.split(".") if part.isdigit()]


def _unit_mm(sensor: Any) -> float:
    """The depth sensor's step in mm, without the digits that float32 made up."""
    return float(f"{sensor.as_depth_sensor().get_depth_scale() * 1000:.6g}")


def _bgr(frame: Any) -> NDArray[np.uint8]:
    """The picture as an array of its own: what the SDK hands out is its frame's memory, of which it has 16."""
    pixels: Any = np.asanyarray(frame.get_data())
    kind = frame.get_profile().format().name
    if kind == "bgr8":
        return np.array(pixels, dtype=np.uint8)
    if kind in ("yuyv", "uyvy"):
        pixels = pixels.view(np.uint8).reshape(frame.get_height(), frame.get_width(), 2)
    return np.asarray(cv2.cvtColor(pixels, TO_BGR[kind]), dtype=np.uint8)
