"""The ``stream`` driver: network cameras (RTSP, HTTP, MJPEG, UDP) through OpenCV's FFmpeg."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common import clock
from common.config import Rig
from common.config.addresses import without_login
from common.config.models import CameraConfig, StreamOptions
from common.errors import CameraError
from services.capture.cameras.base import Description, Grabbed, Stamps
from services.capture.cameras.intrinsics import known_or_guessed
from services.capture.cameras.options import read_options
from services.capture.cameras.stream_address import why_not

USUAL_FPS = 25.0
SOONEST_LOSS = 0.9
"""A read that took this share of the timeout has timed out, whatever OpenCV says of it."""
NEEDED = 2
"""So many pictures show whether their times run: some senders give none, and FFmpeg then 0 for each."""
CLOSE_S = 1.0
_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_STAMPED = ("rtsp", "rtsps", "udp", "rtp")
"""Here each picture has the sender's time. Over HTTP FFmpeg makes the times up from a rate that it guesses."""


@dataclass(frozen=True, slots=True)
class _Picture:
    bgr: NDArray[np.uint8]
    device_ns: int | None
    number: int


class StreamCamera:
    """A network camera; see ``StreamOptions`` for its keys. Raises ConfigError, CameraError as a driver does.

    A thread of its own reads all the time and keeps the newest picture, so that none gets old in a buffer, and so
    that ``grab`` lasts no longer than it may: OpenCV's read lasts up to ``timeout_s`` when the server has stalled,
    and then gives the picture before once more. Pictures passed over are told as ``missed``.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig) -> None:
        self._name = name
        self._config = config
        self._options = read_options(name, config, StreamOptions)
        self._calibration = rig.calibration(name)
        self._shown = without_login(self._options.url)
        self._stamped = self._options.url.startswith(tuple(f"{scheme}:" for scheme in _STAMPED))
        self._news = threading.Condition()
        self._newest: _Picture | None = None
        self._given = 0
        self._lost: str | None = None
        self._closed = False
        capture = self._connect()
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        self._fps = config.fps or (rate if 1 <= rate <= 240 else USUAL_FPS)
        self._reader = threading.Thread(target=self._read_on, args=(capture,), name=f"stream {name}", daemon=True)
        self._reader.start()
        try:
            self._description = self._describe(self._first_picture())
        except CameraError:
            self.close()
            raise

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera. Gives the newest picture, each once."""
        with self._news:
            if self._closed:
                raise CameraError(f"camera {self._name} is closed")
            self._news.wait_for(lambda: self._lost is not None or self._waiting() is not None, timeout_s)
            picture = self._waiting()
            if picture is None:
                if self._lost is not None:
                    raise CameraError(self._lost)
                raise TimeoutError(f"{self._shown} gave no picture in {timeout_s:g} s")
            missed, self._given = picture.number - self._given - 1, picture.number
        if picture.bgr.shape[:2] != (self._description.camera.height, self._description.camera.width):
            self._description = self._describe(picture)
        return Grabbed(picture.bgr, None, picture.device_ns, missed=missed)

    def describe(self) -> Description:
        """See Camera."""
        return self._description

    def close(self) -> None:
        """See Camera. A read that waits for a stalled server ends by its own timeout, and then the connection."""
        with self._news:
            self._closed = True
        self._reader.join(CLOSE_S)

    def _connect(self) -> cv2.VideoCapture:
        timeout_ms = int(self._options.timeout_s * 1000)
        settings = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, timeout_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, timeout_ms]
        with _low_latency(self._options.transport):
            capture = cv2.VideoCapture(self._options.url, cv2.CAP_FFMPEG, settings)
        if not capture.isOpened():
            capture.release()
            raise CameraError(why_not(self._options.url))
        return capture

    def _read_on(self, capture: cv2.VideoCapture) -> None:
        """The reading thread; the capture is its own from here on."""
        try:
            number, before_ns = 0, 0
            while not self._closed:
                began = clock.monotonic_ns()
                found, bgr = capture.read()
                took_s = (clock.monotonic_ns() - began) / 1e9
                if took_s >= SOONEST_LOSS * self._options.timeout_s:
                    self._tell(f"{self._shown} gave no picture for {took_s:.0f} s; is its network up?")
                    return
                if not found or bgr is None:
                    self._tell(f"{self._shown} has ended or was cut off; does its server still run?")
                    return
                number += 1
                stamp_ns = int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
                if number == NEEDED:
                    self._stamped &= stamp_ns > before_ns
                before_ns = stamp_ns
                picture = np.ascontiguousarray(bgr, dtype=np.uint8)
                with self._news:
                    self._newest = _Picture(picture, stamp_ns if self._stamped else None, number)
                    self._news.notify_all()
        except cv2.error as error:
            self._tell(f"{self._shown} can't be decoded ({error.err})")
        finally:
            capture.release()

    def _tell(self, loss: str) -> None:
        with self._news:
            self._lost = loss
            self._news.notify_all()

    def _waiting(self) -> _Picture | None:
        """The newest picture if it wasn't given yet; to be called with the condition held."""
        newest = self._newest
        return newest if newest is not None and newest.number > self._given else None

    def _first_picture(self) -> _Picture:
        def enough() -> bool:
            return self._lost is not None or (self._newest is not None and self._newest.number >= NEEDED)

        with self._news:
            if not self._news.wait_for(enough, self._options.timeout_s) or self._newest is None:
                raise CameraError(self._lost or f"{self._shown} opens but gives no picture; check it with a player")
            # What came while this camera was opened was nobody's yet.
            self._given = self._newest.number - 1
            return self._newest

    def _describe(self, picture: _Picture) -> Description:
        height, width = picture.bgr.shape[:2]
        wanted = (self._config.width or width, self._config.height or height)
        if wanted != (width, height):
            raise CameraError(
                f"{self._shown} gives {width}x{height}, camera {self._name} is configured for {wanted[0]}x{wanted[1]}; "
                "set that in the camera, or leave width and height out"
            )
        camera, warnings = known_or_guessed(self._name, self._calibration, width, height)
        stamps: Stamps = "device" if self._stamped else "arrival"
        return Description(camera=camera, fps=self._fps, warnings=warnings, stamps=stamps)


@contextmanager
def _low_latency(transport: str) -> Iterator[None]:
    """FFmpeg without buffers of its own, for what is opened within; OpenCV takes its options from the environment."""
    before = os.environ.get(_OPTIONS)
    os.environ[_OPTIONS] = f"rtsp_transport;{transport}|fflags;nobuffer|flags;low_delay"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_OPTIONS]
        else:
            os.environ[_OPTIONS] = before
