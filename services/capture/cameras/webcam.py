"""The ``webcam`` driver: USB cameras and whatever else Linux shows as /dev/video*, through OpenCV's V4L2 backend."""

from __future__ import annotations

import os
from contextlib import suppress

import cv2
import numpy as np
from numpy.typing import NDArray

from common import clock
from common.config import Rig
from common.config.models import CameraConfig, WebcamOptions
from common.errors import CameraError
from services.capture.cameras.base import Description, FrameSkippedError, Grabbed, Stamps
from services.capture.cameras.intrinsics import known_or_guessed
from services.capture.cameras.options import read_options
from services.capture.cameras.webcam_controls import Lock, apply, left_on, locks_of
from services.capture.cameras.webcam_devices import MACHINE, Places, capability, find, name_of
from services.capture.cameras.webcam_devices import attached as attached
from services.capture.cameras.webcam_v4l2 import open_device

SIZE = (1280, 720)
FPS = 30.0
FIRST_PICTURE_S = 4.0
"""A camera that has given nothing for this long after its start won't."""
STAMP_IS_OLD_NS = 10_000_000_000
"""A picture that claims to be older than this was stamped by another clock."""
LATE_PERIODS = 1.5
"""A picture this old may have a newer one behind it; one that has just come is up to a period old."""
COMPRESSED = "MJPG"
_END_OF_JPEG = b"\xff\xd9"
_SAME_RATE = 0.05

# OpenCV waits 10 s for a picture unless told otherwise before it waits for the first time; whole seconds only. That
# is the first picture's wait; the later ones are `waitAny`'s, to the millisecond.
os.environ["OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"] = "1"


class WebcamCamera:
    """A webcam; see ``WebcamOptions`` for its keys. Raises ConfigError, CameraError as a driver does.

    Its constructor returns with the first picture at hand, so a camera that opens and gives none is told as lost.
    MJPG is decoded here and not by OpenCV's backend, which passes a damaged picture on as the one before.
    ``device_ns`` is the kernel's CLOCK_MONOTONIC, the clock of ``common.clock.monotonic_ns``, when its first picture
    looks so; else it is told as the device's own.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig, places: Places = MACHINE) -> None:
        self._name = name
        self._options = read_options(name, config, WebcamOptions)
        self._calibration = rig.calibration(name)
        self._node = rig.resolve(self._options.path) if self._options.path else find(self._options, places)
        self._card = capability(self._node).card
        self._serial = name_of(self._node, places) or None
        self._seen_an_end = False
        with open_device(self._node) as device:
            self._locks = locks_of(device, self._options, f"cameras.{name}")
            apply(device, self._locks)
        self._capture: cv2.VideoCapture | None = cv2.VideoCapture(str(self._node), cv2.CAP_V4L2)
        try:
            told = self._negotiate(config)
            self._pending: tuple[NDArray[np.uint8], int | None] | None = self._first_picture()
            self._description = self._describe(told, self._settle(self._locks))
        except (CameraError, OSError):
            self.close()
            raise

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera. Gives the newest picture that waits."""
        raw, stamp = self._pending or self._newest(timeout_s)
        self._pending = None
        return Grabbed(self._decoded(raw), None, stamp)

    def describe(self) -> Description:
        """See Camera."""
        return self._description

    def close(self) -> None:
        """See Camera."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    # -- opening

    def _negotiate(self, config: CameraConfig) -> tuple[str, ...]:
        """Ask for the mode and read back what came of it; returns warnings, raises CameraError for a wrong size."""
        capture = self._opened()
        if not capture.isOpened():
            raise CameraError(f"{self._called} can't be opened as a camera; unplug it and plug it in again")
        size = self._asked_size(config)
        rate = config.fps or FPS
        wanted = self._options.pixel_format
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*wanted))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        capture.set(cv2.CAP_PROP_FPS, rate)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, self._options.buffers)
        self._size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        self._fps = float(capture.get(cv2.CAP_PROP_FPS))
        got = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace")
        self._compressed = got == COMPRESSED
        if self._compressed:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        told = []
        if self._size != size:
            told.append(self._wrong_size(size, demanded=bool(config.width or config.height)))
        if not 0 < self._fps <= 1000:
            self._fps = rate
        elif abs(self._fps / rate - 1) > _SAME_RATE:
            told.append(f"camera {self._name}: {rate:g} frames/s were asked for, it gives {self._fps:g} at this size")
        if got != wanted:
            told.append(f"camera {self._name} gives no {wanted} but {got}; USB may not carry its full frame rate")
        return tuple(told)

    def _asked_size(self, config: CameraConfig) -> tuple[int, int]:
        """The rig's size, else the calibration's, else 720p."""
        width, height = SIZE
        if self._calibration is not None:
            width, height = self._calibration.width, self._calibration.height
        return config.width or width, config.height or height

    def _wrong_size(self, asked: tuple[int, int], *, demanded: bool) -> str:
        """The sentence for another size than asked; raises it as CameraError if the rig file names that size."""
        got = f"{self._size[0]}x{self._size[1]}"
        with open_device(self._node) as device:
            modes = [mode for mode in device.modes() if mode.fourcc == self._options.pixel_format]
        sizes = ", ".join(dict.fromkeys(f"{mode.width}x{mode.height}" for mode in modes)) or "no list of its sizes"
        sentence = f"{self._called} gives {got} instead of {asked[0]}x{asked[1]}; it has {sizes}"
        if demanded:
            raise CameraError(f"{sentence}; set width and height of camera {self._name} to one of these")
        return sentence

    def _first_picture(self) -> tuple[NDArray[np.uint8], int | None]:
        """Start the stream; raises CameraError if no picture comes of it."""
        deadline = clock.monotonic_ns() + int(FIRST_PICTURE_S * 1e9)
        capture = self._opened()
        if capture.grab():
            return self._retrieved(capture)
        try:
            return self._newest((deadline - clock.monotonic_ns()) / 1e9)
        except TimeoutError as error:
            raise CameraError(
                f"{self._called} opens but gives no picture; plug it in directly, not by a hub"
            ) from error

    def _settle(self, locks: tuple[Lock, ...]) -> tuple[str, ...]:
        """Settings once more, now that the stream runs; returns warnings."""
        with open_device(self._node) as device:
            refused = apply(device, locks)
            return (*(f"camera {self._name}: {text}" for text in refused), *left_on(device, self._name))

    def _describe(self, told: tuple[str, ...], settings: tuple[str, ...]) -> Description:
        width, height = self._size
        camera, warnings = known_or_guessed(self._name, self._calibration, width, height, self._serial)
        stamps = self._kind_of_stamps()
        return Description(camera=camera, fps=self._fps, warnings=(*told, *settings, *warnings), stamps=stamps)

    def _kind_of_stamps(self) -> Stamps:
        """Nearly all drivers stamp by the host's clock; one may have its own, or none."""
        assert self._pending is not None
        stamp = self._pending[1]
        if stamp is None:
            return "arrival"
        return "monotonic" if 0 <= clock.monotonic_ns() - stamp < STAMP_IS_OLD_NS else "device"

    # -- pictures

    def _newest(self, timeout_s: float) -> tuple[NDArray[np.uint8], int | None]:
        """The newest picture as it came, after at most ``timeout_s``; those that waited before it are passed over."""
        capture = self._opened()
        if not self._wait(capture, timeout_s):
            raise TimeoutError(f"{self._called} gave no picture in {timeout_s:g} s")
        raw, stamp = self._retrieved(capture)
        for _ in range(self._options.buffers):
            behind = stamp is not None and clock.monotonic_ns() - stamp > LATE_PERIODS * 1e9 / self._fps
            if not behind or not self._wait(capture, 0.0):
                break
            raw, stamp = self._retrieved(capture)
        return raw, stamp

    def _wait(self, capture: cv2.VideoCapture, timeout_s: float) -> bool:
        """Whether a picture came in time (and was taken over by OpenCV); raises CameraError if the camera is gone."""
        try:
            woken, ready = cv2.VideoCapture.waitAny([capture], max(1, int(timeout_s * 1e9)))
        except cv2.error as error:
            raise CameraError(self._why_lost()) from error
        if woken and not len(ready):
            raise CameraError(self._why_lost())
        return bool(woken)

    def _retrieved(self, capture: cv2.VideoCapture) -> tuple[NDArray[np.uint8], int | None]:
        """The picture that OpenCV has taken over, and its time in ns of CLOCK_MONOTONIC (None: not told)."""
        found, raw = capture.retrieve()
        if not found or raw is None:
            raise CameraError(self._why_lost())
        # V4L2 stamps in microseconds; as a double of milliseconds they are exact to less than that for 200 years.
        microseconds = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e3)
        return raw.astype(np.uint8, copy=False), microseconds * 1000 if microseconds > 0 else None

    def _decoded(self, raw: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 BGR; raises FrameSkippedError for a picture that came damaged."""
        picture: NDArray[np.uint8] | None = raw
        if self._compressed:
            whole = raw.tobytes().rstrip(b"\0").endswith(_END_OF_JPEG)
            self._seen_an_end |= whole
            # A cut picture decodes without an error, grey from the cut on; some cameras never write the end mark.
            picture = None if self._seen_an_end and not whole else _jpeg(raw)
        if picture is None or picture.shape != (self._size[1], self._size[0], 3):
            raise FrameSkippedError(f"{self._called} sent a damaged picture; is its cable good?", "damaged")
        return np.ascontiguousarray(picture)

    def _opened(self) -> cv2.VideoCapture:
        if self._capture is None:
            raise CameraError(f"camera {self._name} is closed")
        return self._capture

    def _why_lost(self) -> str:
        try:
            with open_device(self._node) as device:
                device.capability()
        except (CameraError, OSError):
            return f"{self._called} is gone: unplugged, or without power"
        return (
            f"{self._called} doesn't stream; if several cameras share a USB port, give each its own or smaller pictures"
        )

    @property
    def _called(self) -> str:
        return f"the webcam {self._card} ({self._node})"


def _jpeg(raw: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    with suppress(cv2.error):
        return cv2.imdecode(raw, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)  # type: ignore[return-value]
    return None
