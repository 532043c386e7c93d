"""RealSense cameras that are software, through the real SDK: streaming live, or recorded to a ``.db3`` file."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs
from numpy.typing import NDArray

Colour = NDArray[np.uint8]
Depth = NDArray[np.uint16]
PERIOD_MS = 1000 / 30


@dataclass(frozen=True)
class Lens:
    """Intrinsics: size and focal length in px, the principal point in the middle, a distortion of the SDK's."""

    width: int
    height: int
    focal: float
    distortion: str = "none"
    coefficients: Sequence[float] = (0.0,) * 5

    def intrinsics(self) -> Any:
        made = rs.intrinsics()
        made.width, made.height = self.width, self.height
        made.fx = made.fy = self.focal
        made.ppx, made.ppy = (self.width - 1) / 2, (self.height - 1) / 2
        made.model = getattr(rs.distortion, self.distortion)
        made.coeffs = list(self.coefficients)
        return made


@dataclass(frozen=True)
class Build:
    """How a software camera is built. ``rotation`` (3x3) and ``translation_mm``: depth camera to colour camera."""

    colour: Lens = Lens(160, 120, 130.0)
    depth: Lens | None = Lens(160, 120, 130.0)
    serial: str = "012345678901"
    fps: int = 30
    format: str = "bgr8"
    unit_mm: float = 1.0
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    translation_mm: Sequence[float] = (0.0, 0.0, 0.0)
    domain: str = "hardware_clock"
    usb: str = "3.2"


class SoftCamera:
    """A software device with a colour and a depth sensor; ``give`` sends a frame."""

    def __init__(self, build: Build | None = None) -> None:
        self.build = build or Build()
        self.device = rs.software_device()
        for key, text in (
            (rs.camera_info.name, "Software RealSense"),
            (rs.camera_info.serial_number, self.build.serial),
            (rs.camera_info.firmware_version, "5.16.0.1"),
            (rs.camera_info.usb_type_descriptor, self.build.usb),
        ):
            self.device.register_info(key, text)
        self.colour = self.device.add_sensor("RGB Camera")
        self._colour_profiles: list[Any] = []
        self._depth_profiles: list[Any] = []
        self._colour_profile = self.add_colour(self.build.colour, self.build.fps, self.build.format, default=True)
        self.depth: Any | None = None
        if self.build.depth is not None:
            self.depth = self.device.add_sensor("Stereo Module")
            self._depth_profile = self.add_depth(self.build.depth, self.build.fps, default=True)
            self.depth.add_read_only_option(rs.option.depth_units, self.build.unit_mm / 1000)
        self.device.create_matcher(rs.matchers.dlr_c)

    def add_colour(self, lens: Lens, fps: int, form: str = "bgr8", *, default: bool = False) -> Any:
        """A further colour mode."""
        size = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4, "yuyv": 2, "uyvy": 2}[form]
        stream = _stream(rs.stream.color, 1, lens, fps, getattr(rs.format, form), size)
        profile = self.colour.add_video_stream(stream, default)
        for depth in self._depth_profiles:
            self._place(depth, profile)
        self._colour_profiles.append(profile)
        return profile

    def add_depth(self, lens: Lens, fps: int, *, default: bool = False) -> Any:
        """A further depth mode."""
        assert self.depth is not None
        profile = self.depth.add_video_stream(_stream(rs.stream.depth, 2, lens, fps, rs.format.z16, 2), default)
        for colour in self._colour_profiles:
            self._place(profile, colour)
        self._depth_profiles.append(profile)
        return profile

    def give(self, number: int, colour: Colour, depth: Depth | None = None, at_ms: float | None = None) -> None:
        """Send a frame; without ``depth`` the colour picture alone."""
        stamp = 1000 + number * 1000 / self.build.fps if at_ms is None else at_ms
        if depth is not None:
            assert self.depth is not None
            self._send(self.depth, self._depth_profile, depth[..., None].view(np.uint8), number, stamp)
        self._send(self.colour, self._colour_profile, colour, number, stamp)

    def _place(self, depth: Any, colour: Any) -> None:
        between = rs.extrinsics()
        between.rotation = [float(value) for value in self.build.rotation.T.ravel()]
        between.translation = [value / 1000 for value in self.build.translation_mm]
        depth.register_extrinsics_to(colour, between)

    def _send(self, sensor: Any, profile: Any, pixels: NDArray[Any], number: int, stamp: float) -> None:
        frame = rs.software_video_frame()
        frame.bpp = pixels.shape[2]
        frame.stride = pixels.shape[1] * pixels.shape[2]
        frame.pixels = np.ascontiguousarray(pixels).ravel()
        frame.timestamp, frame.frame_number = stamp, number
        frame.domain = getattr(rs.timestamp_domain, self.build.domain)
        frame.profile = profile.as_video_stream_profile()
        if sensor is self.depth:
            frame.depth_units = self.build.unit_mm / 1000
        sensor.on_video_frame(frame)


class Plugged:
    """An SDK context that sees software cameras and recordings as attached devices."""

    def __init__(self) -> None:
        self.context = rs.context()
        self._kept: list[Any] = []
        self._loaded: dict[Path, Any] = {}
        # The context holds its devices weakly: what this callback hears keeps them attached. A driver that streams
        # has the callback for itself, so software cameras are to be plugged before it opens.
        self.context.set_devices_changed_callback(self._kept.append)

    def plug(self, build: Build | None = None) -> SoftCamera:
        """A software camera."""
        camera = SoftCamera(build)
        self._kept.append(camera)
        camera.device.add_to(self.context)
        return camera

    def load(self, recording: Path) -> None:
        """A recording as a camera, whose coming and going the SDK tells."""
        self._loaded[recording] = self.context.load_device(str(recording))

    def unload(self, recording: Path) -> None:
        """Unplug it."""
        self.context.unload_device(str(recording))
        del self._loaded[recording]


def record(path: Path, frames: Iterable[tuple[Colour, Depth | None]], build: Build | None = None) -> Path:
    """Write a recording of a software camera; numbers from 1, a frame's time apart."""
    path.unlink(missing_ok=True)
    camera = SoftCamera(build)
    recorder = rs.recorder(str(path), camera.device)
    queue = rs.frame_queue(1)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(queue)
    for number, (colour, depth) in enumerate(frames, 1):
        camera.give(number, colour, depth)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    # The file is closed with the last reference to the recorder.
    del recorder, sensors, sensor, queue, camera
    gc.collect()
    return path


def plain_frames(count: int, build: Build | None = None) -> list[tuple[Colour, Depth | None]]:
    """Pictures of grey 10, 20, ... with depths of 1000, 2000, ... steps."""
    made = build or Build()
    return [
        (
            np.full((made.colour.height, made.colour.width, 3), (10 * number - 1) % 250 + 1, np.uint8),
            None
            if made.depth is None
            else np.full((made.depth.height, made.depth.width), (1000 * number - 1) % 65000 + 1, np.uint16),
        )
        for number in range(1, count + 1)
    ]


def _stream(kind: Any, uid: int, lens: Lens, fps: int, form: Any, size: int) -> Any:
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid = kind, 0, uid
    stream.width, stream.height, stream.fps = lens.width, lens.height, fps
    stream.bpp, stream.fmt, stream.intrinsics = size, form, lens.intrinsics()
    return stream
