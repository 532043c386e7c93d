"""Framesets of a RealSense: live from an attached camera, or from a recording without losing one."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from common import clock
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import EndOfStreamError
from services.capture.cameras.realsense_modes import Mode, Wish, choose
from services.capture.cameras.realsense_sdk import camera_error, find_device, info_of, rs, title_of

QUEUE = 4
"""Framesets that wait for a slow reader; older ones are dropped (and counted by their numbers)."""
POLL_S = 0.1
PAIR_PERIODS = 0.75
"""Colour and depth belong together if they are less than this share of a frame's time apart."""
RESET = 10_000
"""A step in the numbers larger than this is a counter that was set anew, not lost frames."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A colour frame, with depth the frameset that it belongs to; ``missed`` as in ``Grabbed``."""

    colour: Any = field(repr=False)
    frameset: Any | None = field(repr=False)
    missed: int


class Pairing:
    """Picks the framesets that are a new picture with depth of the same moment.

    The SDK also hands out those in which one of the two is missing or still the one before.
    """

    def __init__(self, fps: float, *, depth: bool) -> None:
        self._most_ms = PAIR_PERIODS * 1000 / fps
        self._depth = depth
        self._number: int | None = None

    def take(self, frame: Any) -> Pair | None:
        """The pair in what the SDK gave, None if that is none."""
        frameset = frame.as_frameset() if frame.is_frameset() else None
        colour = frameset.get_color_frame() if frameset is not None else frame.as_video_frame()
        if not colour or colour.get_frame_number() == self._number:
            return None
        if self._depth and not self._matches(colour, frameset):
            return None
        number = int(colour.get_frame_number())
        step = 1 if self._number is None else number - self._number
        self._number = number
        return Pair(colour, frameset, step - 1 if 1 < step < RESET else 0)

    def _matches(self, colour: Any, frameset: Any) -> bool:
        depth = None if frameset is None else frameset.get_depth_frame()
        if not depth or depth.get_frame_timestamp_domain() != colour.get_frame_timestamp_domain():
            return False
        return bool(abs(depth.get_timestamp() - colour.get_timestamp()) < self._most_ms)


class Stream(Protocol):
    """Started streaming when it was made."""

    device: Any
    colour: Mode
    depth: Mode | None

    def next(self, timeout_s: float) -> Pair:
        """The next pair; raises TimeoutError, CameraError, EndOfStreamError as a driver does."""

    def close(self) -> None:
        """Stop streaming; idempotent."""


class LiveStream:
    """An attached camera.

    Frames come through a queue of ours: a pipeline that is asked for them by ``wait_for_frames`` starts a camera that
    was unplugged anew by itself, for up to 15 s, and forgets its settings.
    """

    def __init__(self, context: Any, serial: str | None, wish: Wish) -> None:
        self.device = find_device(context, serial)
        self._title = title_of(self.device)
        self._gone = threading.Event()
        self._context = context
        self._queue = rs.frame_queue(QUEUE, True)
        self._pipeline: Any | None = None
        try:
            self.colour, self.depth = choose(self.device, wish)
        except RuntimeError as error:
            raise camera_error(f"the {self._title} doesn't tell its modes", error) from error
        self._pairing = Pairing(self.colour.fps, depth=self.depth is not None)

    def start(self) -> None:
        """Begin; apart from the constructor, because settings come in between."""
        self._context.set_devices_changed_callback(self._on_devices)
        pipeline, config = rs.pipeline(self._context), rs.config()
        serial = info_of(self.device, rs.camera_info.serial_number)
        if serial:
            config.enable_device(serial)
        for mode in (self.colour, self.depth):
            if mode is not None:
                mode.ask(config)
        try:
            if not config.can_resolve(rs.pipeline_wrapper(pipeline)):
                raise CameraError(f"the {self._title} can't stream now; it was unplugged, or another program uses it")
            pipeline.start(config, self._queue)
        except RuntimeError as error:
            raise camera_error(f"the {self._title} can't be started", error) from error
        self._pipeline = pipeline

    def next(self, timeout_s: float) -> Pair:
        """See Stream."""
        until_ns = clock.monotonic_ns() + int(timeout_s * 1e9)
        while True:
            if self._gone.is_set():
                raise CameraError(f"the {self._title} was unplugged; it is taken up again when it is back")
            left_s = max(0.0, (until_ns - clock.monotonic_ns()) / 1e9)
            found, frame = self._queue.try_wait_for_frame(int(min(left_s, POLL_S) * 1000))
            pair = self._pairing.take(frame) if found else None
            if pair is not None:
                return pair
            if not found and left_s <= 0:
                raise TimeoutError(f"the {self._title} gave no picture within {timeout_s:g} s")

    def close(self) -> None:
        """See Stream."""
        self._context.set_devices_changed_callback(_nobody)
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            _stop(pipeline)

    def _on_devices(self, information: Any) -> None:
        """Called in a thread of the SDK's."""
        if information.was_removed(self.device):
            self._gone.set()


class RecordedStream:
    """A recording, played as fast as it is asked for; its first frame is read at once, to know that there is one."""

    def __init__(self, path: Path, wish: Wish) -> None:
        if not path.is_file():
            raise CameraError(f"the recording {path} is gone" if path.parent.is_dir() else f"there is no {path}")
        self._path = path
        self._context = rs.context()
        self._pipeline: Any | None = rs.pipeline(self._context)
        self._resuming: threading.Thread | None = None
        try:
            device = self._resolved(rs.config()).get_device()
            self.colour, self.depth = choose(device, wish)
            self._begin()
        except RuntimeError as error:
            self.close()
            raise CameraError(
                f"{path} can't be read as a RealSense recording: {' '.join(str(error).split())}"
            ) from error
        except ConfigError as error:
            self.close()
            raise ConfigError(f"{path}: {error.message}") from error
        self._pairing = Pairing(self.colour.fps, depth=self.depth is not None)
        self._first: Pair | None = self._first_pair()

    def next(self, timeout_s: float) -> Pair:
        """See Stream."""
        first, self._first = self._first, None
        return first or self._read(timeout_s)

    def close(self) -> None:
        """See Stream."""
        self._first = None
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            _stop(pipeline)
        if self._resuming is not None:
            self._resuming.join()

    def _resolved(self, config: Any) -> Any:
        assert self._pipeline is not None
        config.enable_device_from_file(str(self._path), repeat_playback=False)
        return config.resolve(rs.pipeline_wrapper(self._pipeline))

    def _begin(self) -> None:
        """In this order no frame is lost: not in real time, paused until the pipeline listens.

        ``resume`` waits until the player has taken note, which it can't while it waits for a reader of its first
        frame: in one opening of five it hung for the SDK's limit of 10 s. So it gets a thread, and this one reads.
        """
        assert self._pipeline is not None
        config = rs.config()
        for mode in (self.colour, self.depth):
            if mode is not None:
                mode.ask(config)
        self.device = self._resolved(config).get_device()
        self._playback = self.device.as_playback()
        self._playback.set_real_time(False)
        self._playback.pause()
        self._pipeline.start(config)
        self._resuming = threading.Thread(target=self._playback.resume, name="realsense-resume", daemon=True)
        self._resuming.start()

    def _first_pair(self) -> Pair:
        try:
            return self._read(5.0)
        except (EndOfStreamError, TimeoutError) as error:
            self.close()
            what = "colour and depth of one moment" if self.depth else "colour"
            raise CameraError(f"the recording {self._path} holds no frame with {what}") from error

    def _read(self, timeout_s: float) -> Pair:
        until_ns = clock.monotonic_ns() + int(timeout_s * 1e9)
        while self._pipeline is not None:
            try:
                found, frameset = self._pipeline.try_wait_for_frames(int(POLL_S * 1000))
                ended = not found and self._playback.current_status() == rs.playback_status.stopped
            except RuntimeError as error:
                raise camera_error(f"the recording {self._path} can't be read on", error) from error
            pair = self._pairing.take(frameset) if found else None
            if pair is not None:
                return pair
            if ended:
                raise EndOfStreamError(f"all of {self._path} was played")
            if clock.monotonic_ns() > until_ns:
                raise TimeoutError(f"{self._path} gave no frame within {timeout_s:g} s")
        raise CameraError(f"the recording {self._path} is closed")


def _nobody(_: Any) -> None:
    """Hears no more of devices that come and go."""


def _stop(pipeline: Any) -> None:
    try:
        pipeline.stop()
    except RuntimeError:
        return  # it never began, or its camera is gone: nothing streams either way
