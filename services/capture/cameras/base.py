"""The contract of a camera driver. Grab loop, reconnection, stamping and the ring are written once, in the grabber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from common.config import Rig
from common.config.models import CameraConfig
from common.errors import TagmillError
from common.labels import CameraLabel
from common.messages import TrueObject


class EndOfStreamError(TagmillError):
    """The camera has given its last frame (a file that is at its end); nothing is wrong."""

    code = "end_of_stream"


class FrameSkippedError(TagmillError):
    """This one frame can't be had, the next one may; ``reason`` is the word it is counted under."""

    code = "frame_skipped"

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Grabbed:
    """A frame as the driver gives it.

    ``bgr`` (H, W, 3) uint8 BGR, C-contiguous; ``depth`` (H, W) uint16 aligned to it, 0 = invalid. The arrays are
    the grabber's until its next call of ``grab``. ``device_ns``: the camera's own clock, any origin.
    ``source_name``: the picture's file name, or ``VIDEO#index``. ``truth``: what a renderer knows.
    ``missed``: how many frames the camera has numbered since the one before that never arrived.
    """

    bgr: NDArray[np.uint8]
    depth: NDArray[np.uint16] | None = None
    device_ns: int | None = None
    source_name: str | None = None
    truth: tuple[TrueObject, ...] | None = None
    missed: int = 0


Stamps = Literal["arrival", "device", "monotonic", "media"]


@dataclass(frozen=True, slots=True)
class Description:
    """What a camera says of itself; fits the frame that was grabbed last (or will be grabbed first).

    ``depth_unit_mm``: mm per step of the depth picture, None = no depth. ``fps`` is nominal. ``paced``: the grabber
    waits for a frame's label before it grabs the next. ``waits_for_start``: plays when a recording starts; such a
    driver is a ``Rewindable``. ``warnings``: sentences for the operator.

    ``stamps``: how the grabber gets a frame's host time. ``arrival``: when ``grab`` gave it. ``device``: ``device_ns``
    is of a camera's running clock, which is mapped to the host's (any origin, any drift: ``device_clock``).
    ``monotonic``: ``device_ns`` *is* the host's CLOCK_MONOTONIC (V4L2). ``media``: recorded pictures, whose
    ``device_ns`` is their own time; stamped by arrival, and the only ones that may look the same for long.
    """

    camera: CameraLabel
    fps: float
    depth_unit_mm: float | None = None
    paced: bool = False
    waits_for_start: bool = False
    stamps: Stamps = "arrival"
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Attached:
    """A camera that a driver finds attached; how `tagmill cameras list` gets to know it.

    A driver's module may offer ``attached() -> list[Attached]`` (another place is named in the registry's ``Entry``).
    It is called in a process of its own with a deadline of 2 s, never opens a camera that may be in use for longer
    than it needs, and logs nothing on stdout. What keeps the driver from looking at all is a CameraError (no
    permission, a missing library) or an ImportError (no SDK: the registry adds the cure), each one clear sentence.

    ``driver``: the registry's name. ``name``: the model, for people. ``serial`` is what the rig file's ``serial``
    takes, ``address`` what finds it without (``/dev/video0``, a USB port, a URL); empty where there is none.
    ``modes``: a few words each (``colour 1280x720 30``). ``note``: what is wrong with this one camera and what to do
    (busy, USB 2, no permission), else empty.
    """

    driver: str
    name: str
    serial: str = ""
    address: str = ""
    modes: tuple[str, ...] = ()
    note: str = ""


class Camera(Protocol):
    """An open camera. Used from one thread; ``close`` is idempotent.

    Its constructor ``Driver(name: str, config: CameraConfig, rig: Rig)`` connects: ConfigError for keys that can't be
    used (nobody retries), CameraError if the camera isn't there (retried with back-off).
    """

    def grab(self, timeout_s: float) -> Grabbed:
        """The next frame, after at most ``timeout_s``; a driver keeps its own pace, as a camera does.

        Raises TimeoutError if none came in time, FrameSkippedError if only this one is spoilt, CameraError if the
        camera is lost (the grabber closes and reopens it), EndOfStreamError (again and again) after the last.
        """

    def describe(self) -> Description:
        """See Description. Its size, intrinsics or depth may change with a frame; the grabber then makes a new ring."""

    def close(self) -> None:
        """Disconnect."""


@runtime_checkable
class Rewindable(Protocol):
    """A camera that can begin again."""

    def rewind(self, frame: int = 0) -> None:
        """The next ``grab`` gives ``frame`` (from 0); raises CameraError if the camera is gone."""


class Driver(Protocol):
    """How a camera is opened: a driver's class or a function."""

    def __call__(self, name: str, config: CameraConfig, rig: Rig) -> Camera:
        """Connect; raises ConfigError or CameraError."""
