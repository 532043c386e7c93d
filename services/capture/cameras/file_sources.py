"""What the ``files`` driver plays: a list of pictures or a video, each with optional depth pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from common.errors import CameraError
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.pictures import (
    PICTURES,
    Colour,
    Depth,
    list_pictures,
    match_depth,
    read_depth,
    read_picture,
)


@dataclass(frozen=True, slots=True)
class FileFrame:
    """A frame of a file: pixels as in ``Grabbed``, its time in the video (ns), its name."""

    bgr: Colour
    depth: Depth | None
    device_ns: int | None
    name: str


class Source(Protocol):
    """Frames from files, in order."""

    fps: float | None
    """As the file says, None if it doesn't."""

    def read(self) -> FileFrame | None:
        """The next frame, None after the last.

        Raises FrameSkippedError for one that can't be read (the next call goes on after it), CameraError if the
        files are gone.
        """

    def rewind(self, frame: int) -> None:
        """Go on at ``frame`` (from 0); raises CameraError if the files are gone."""

    def close(self) -> None:
        """Let go of the files; idempotent."""


def open_source(path: Path, depth_path: Path | None) -> Source:
    """A video, if ``path`` is one file that is no picture; else pictures. Raises CameraError."""
    if path.is_file() and path.suffix.lower() not in PICTURES:
        return VideoSource(path, depth_path)
    return PictureSource(path, depth_path)


class PictureSource:
    """A folder, a glob or a single picture."""

    fps: float | None = None

    def __init__(self, path: Path, depth_path: Path | None) -> None:
        self._path = path
        self._depth_path = depth_path
        self._next = 0
        self._list()

    def read(self) -> FileFrame | None:
        """See Source."""
        if self._next >= len(self._pictures):
            return None
        picture, depth_file = self._pictures[self._next], self._depths[self._next]
        self._next += 1
        bgr = read_picture(picture)
        return FileFrame(bgr, _depth_for(bgr, depth_file), None, picture.name)

    def rewind(self, frame: int) -> None:
        """See Source; pictures that came or went since the last pass are noticed at frame 0."""
        if frame == 0:
            self._list()
        self._next = frame

    def close(self) -> None:
        """See Source."""
        self._next = len(self._pictures)

    def _list(self) -> None:
        self._pictures = list_pictures(self._path)
        self._depths: list[Path | None] = [None] * len(self._pictures)
        if self._depth_path is not None:
            self._depths = match_depth(self._pictures, list_pictures(self._depth_path))


class VideoSource:
    """A video file; frame n's depth picture is the n-th of the depth folder."""

    def __init__(self, path: Path, depth_path: Path | None) -> None:
        self._path = path
        self._depths = [] if depth_path is None else list_pictures(depth_path)
        self._index = 0
        self._last_ns = -1
        self._video = self._open()
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        self.fps: float | None = rate if 0.01 <= rate <= 1000 else None

    def read(self) -> FileFrame | None:
        """See Source."""
        found, picture = self._video.read()
        if not found or picture is None:
            return None
        index, self._index = self._index, self._index + 1
        bgr = np.ascontiguousarray(picture, dtype=np.uint8)
        depth = _depth_for(bgr, self._depths[index] if index < len(self._depths) else None)
        return FileFrame(bgr, depth, self._time_of(index), f"{self._path.name}#{index}")

    def rewind(self, frame: int) -> None:
        """See Source. Opens the file anew and reads up to ``frame``: seeking is not exact in every format."""
        self._video.release()
        self._video = self._open()
        self._index, self._last_ns = 0, -1
        while self._index < frame and self._video.grab():
            self._index += 1

    def close(self) -> None:
        """See Source."""
        self._video.release()

    def _open(self) -> cv2.VideoCapture:
        if not self._path.is_file():
            raise CameraError(f"the video {self._path} is gone")
        video = cv2.VideoCapture(str(self._path))
        if not video.isOpened():
            raise CameraError(f"{self._path} can't be read as a video; it is damaged or of an unknown format")
        return video

    def _time_of(self, index: int) -> int:
        """The frame's time stamp; some containers name none, then it follows from the frame rate."""
        stamp = int(self._video.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        if stamp <= self._last_ns:
            stamp = max(self._last_ns + 1, int(index / (self.fps or 25.0) * 1e9))
        self._last_ns = stamp
        return stamp


def _depth_for(bgr: Colour, path: Path | None) -> Depth | None:
    if path is None:
        return None
    depth = read_depth(path)
    if depth.shape != bgr.shape[:2]:
        height, width = bgr.shape[:2]
        raise FrameSkippedError(
            f"{path} has {depth.shape[1]}x{depth.shape[0]} pixels, its picture {width}x{height}; "
            "depth must be aligned to the picture",
            "depth_size",
        )
    return depth
