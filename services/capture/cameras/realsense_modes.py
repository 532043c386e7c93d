"""Which of a RealSense's modes fit what the rig file asks for."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from common.errors import CameraError, ConfigError
from services.capture.cameras.realsense_sdk import on_usb_2, rs, title_of

SIZE = (1280, 720)
FPS = 30
COLOUR_FORMATS = ("bgr8", "rgb8", "bgra8", "rgba8", "yuyv", "uyvy")
"""Those that can be made BGR, the least work first."""
DEPTH_FORMATS = ("z16",)


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked for; None leaves the choice to the camera. ``depth_size`` is (width, height)."""

    width: int | None = None
    height: int | None = None
    fps: float | None = None
    depth: bool = True
    depth_size: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Mode:
    """One way in which a sensor can stream. ``format`` is the SDK's word."""

    sensor: Any = field(repr=False)  # the SDK's own texts of its objects can crash
    profile: Any = field(repr=False)
    width: int
    height: int
    fps: int
    format: str

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height

    def ask(self, config: Any) -> None:
        """Ask a pipeline's configuration for this mode and no other."""
        config.enable_stream(self.profile.stream_type(), self.width, self.height, self.profile.format(), self.fps)


def modes_of(device: Any, stream: Any, formats: tuple[str, ...]) -> list[Mode]:
    """All modes of a stream (``rs.stream.color``, ``rs.stream.depth``) in one of the formats."""
    found = []
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() != stream or profile.format().name not in formats:
                continue
            video = profile.as_video_stream_profile()
            found.append(Mode(sensor, video, video.width(), video.height(), profile.fps(), profile.format().name))
    return found


def choose(device: Any, wish: Wish) -> tuple[Mode, Mode | None]:
    """The colour mode and the depth mode of the same rate.

    Raises ConfigError that lists what there is; CameraError where a USB 3 port may offer what is missing.
    """
    colour = _colour(device, wish)
    return colour, _depth(device, wish, colour) if wish.depth else None


def summary(modes: Iterable[Mode]) -> dict[tuple[int, int], list[int]]:
    """Rates by size, the largest first."""
    found: dict[tuple[int, int], set[int]] = {}
    for mode in modes:
        found.setdefault(mode.size, set()).add(mode.fps)
    return {size: sorted(found[size], reverse=True) for size in sorted(found, reverse=True)}


def _colour(device: Any, wish: Wish) -> Mode:
    modes = modes_of(device, rs.stream.color, COLOUR_FORMATS)
    fitting = [
        mode
        for mode in modes
        if wish.width in (None, mode.width) and wish.height in (None, mode.height) and wish.fps in (None, mode.fps)
    ]
    if not fitting:
        size = f" {wish.width or 'any'}x{wish.height or 'any'}" if wish.width or wish.height else ""
        rate = f" at {wish.fps:g} frames/s" if wish.fps else ""
        raise _missing(device, "colour", size + rate, modes)
    return min(
        fitting,
        key=lambda mode: (
            mode.size != SIZE,
            abs(mode.fps - FPS),
            -mode.width * mode.height,
            COLOUR_FORMATS.index(mode.format),
        ),
    )


def _depth(device: Any, wish: Wish, colour: Mode) -> Mode:
    modes = modes_of(device, rs.stream.depth, DEPTH_FORMATS)
    at_rate = [mode for mode in modes if mode.fps == colour.fps]
    fitting = [mode for mode in at_rate if wish.depth_size in (None, mode.size)]
    if not fitting:
        size = "" if wish.depth_size is None else " {}x{}".format(*wish.depth_size)
        raise _missing(device, "depth", f"{size} at {colour.fps} frames/s (colour's rate)", modes)
    area = colour.width * colour.height
    return min(fitting, key=lambda mode: (mode.size != colour.size, abs(math.log(mode.width * mode.height / area))))


def _missing(device: Any, what: str, asked: str, modes: list[Mode]) -> ConfigError | CameraError:
    offered = "; ".join(
        f"{width}x{height} at {', '.join(map(str, rates))}" for (width, height), rates in summary(modes).items()
    )
    text = f"the {title_of(device)} has no {what} mode{asked}; it has {offered or 'no ' + what + ' at all'}"
    if on_usb_2(device):
        return CameraError(f"{text}; it is on USB 2, plug it into a USB 3 port for all its modes")
    cure = "; say `depth: false`" if what == "depth" and not modes else ""
    return ConfigError(text + cure)
