"""The frames of `bench bus` and what a reader does with one."""

from __future__ import annotations

import resource
from dataclasses import dataclass
from typing import Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from common import clock
from common.ids import new_boot
from common.messages import FrameAnnounced, FrameRef, Stamp

WIDTH, HEIGHT = 1280, 720
COLOUR_BYTES, DEPTH_BYTES = WIDTH * HEIGHT * 3, WIDTH * HEIGHT * 2
CAMERA = "cam0"
BOOT = new_boot()
Colour = NDArray[np.uint8]
Depth = NDArray[np.uint16]
Form = Literal["grey", "copy"]

_VARIANTS = 4


@dataclass(frozen=True)
class Frame:
    """A frame as a camera's driver gives it."""

    bgr: Colour
    depth: Depth


@dataclass(frozen=True)
class Taken:
    """A frame that a reader has seen whole: its count (0: a warm-up) and when it was captured."""

    count: int
    captured_ns: int


class Sender(Protocol):
    """The capture side of one way to hand frames on."""

    def send(self, frame: Frame, count: int, captured_ns: int) -> None:
        """Give a frame to whoever reads."""

    def close(self) -> None:
        """Leave nothing behind."""


class Receiver(Protocol):
    """A reader's side. ``lost``: frames that were announced but gone before they were read whole."""

    lost: int

    def receive(self, timeout_s: float) -> list[Taken]:
        """Wait for frames and do the reader's work on each."""

    def close(self) -> None:
        """Leave nothing behind."""


def camera_frames() -> list[Frame]:
    """A few different frames; what is in them is of no account, but that the pages are really touched."""
    chance = np.random.default_rng(1)
    return [
        Frame(
            chance.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8),
            chance.integers(0, 5000, (HEIGHT, WIDTH), np.uint16),
        )
        for _ in range(_VARIANTS)
    ]


def announced(ring: str, number: int, count: int, captured_ns: int) -> FrameAnnounced:
    """What is said of a frame; the same message in every way of handing it on."""
    ref = FrameRef(
        camera=CAMERA,
        boot=BOOT,
        ring=ring,
        frame=number,
        count=count,
        captured_mono_ns=captured_ns,
        captured_wall_ns=clock.wall_ns(),
    )
    return FrameAnnounced(ref=ref)


def stamp(number: int) -> Stamp:
    """As our publisher makes it."""
    return Stamp(source="capture.cam0", boot=BOOT, seq=number, mono_ns=clock.monotonic_ns(), wall_ns=clock.wall_ns())


class Work:
    """The reader's work: the grey picture, made in place, or of a full copy of picture and depth.

    Into memory that is there already, as a reader at 30 frames/s does it: fresh pages cost more than the copy.
    """

    def __init__(self, form: Form) -> None:
        self._copies = form == "copy"
        self._bgr = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        self._depth = np.zeros((HEIGHT, WIDTH), np.uint16)
        self._grey = np.zeros((HEIGHT, WIDTH), np.uint8)

    def do(self, bgr: Colour, depth: Depth) -> None:
        """One frame."""
        if self._copies:
            np.copyto(self._bgr, bgr)
            np.copyto(self._depth, depth)
            bgr = self._bgr
        cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY, dst=self._grey)


def cpu_s() -> float:
    """User and system time of this process with all its threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime
