"""Videos through PyAV (extra ``video``): each frame with its exact own time, also where the rate varies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np

from common.errors import CameraError
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.file_sources import FileFrame, Recorded, depth_for
from services.capture.cameras.pictures import Colour, list_pictures

_NS = 1_000_000_000
_FASTEST, _SLOWEST = 1000.0, 0.01


class ExactVideoSource:
    """A video file; frame n's depth picture is the n-th of the depth folder. Raises CameraError."""

    recorded = Recorded()

    def __init__(self, path: Path, depth_path: Path | None) -> None:
        self._path = path
        self._depths = [] if depth_path is None else list_pictures(depth_path)
        self._container: Any = None
        self._frames: Iterator[Any] = iter(())
        self.fps: float | None = None
        self._index, self._last_ns = 0, -1
        self.rewind(0)

    def read(self) -> FileFrame | None:
        """See Source."""
        index = self._index
        try:
            frame = next(self._frames, None)
        except av.error.FFmpegError as error:
            self._index += 1
            raise FrameSkippedError(f"{self._path.name}#{index} is damaged: {error.strerror}", "unreadable") from error
        if frame is None:
            return None
        self._index += 1
        bgr = bgr_of(frame)
        depth = depth_for(bgr, self._depths[index] if index < len(self._depths) else None)
        return FileFrame(bgr, depth, self._time_of(frame, index), f"{self._path.name}#{index}")

    def rewind(self, frame: int) -> None:
        """See Source. Opens the file anew and decodes up to ``frame``: seeking is not exact in every format."""
        self.close()
        self._container = open_container(self._path)
        stream = next(iter(self._container.streams.video), None)
        if stream is None:
            self.close()
            raise CameraError(f"{self._path} holds no video")
        rate = float(stream.average_rate or 0)
        self.fps = rate if _SLOWEST <= rate <= _FASTEST else None
        self._frames = Decoded(self._container, stream)
        self._index, self._last_ns = 0, -1
        while self._index < frame and next(self._frames, None) is not None:
            self._index += 1

    def close(self) -> None:
        """See Source."""
        if self._container is not None:
            self._container.close()
            self._container = None
        self._frames = iter(())

    def _time_of(self, frame: Any, index: int) -> int:
        """The frame's own time; a container without times has it by its rate."""
        stamp = int(index / (self.fps or 25.0) * _NS) if frame.pts is None else exact_ns(frame.pts, frame.time_base)
        self._last_ns = max(self._last_ns + 1, stamp)
        return self._last_ns


class Decoded:
    """The frames of one stream in order. What is damaged raises FFmpegError once; the next call goes on behind it."""

    def __init__(self, container: Any, stream: Any) -> None:
        self._packets = container.demux(stream)
        self._ready: list[Any] = []

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        """The next frame; raises FFmpegError for a damaged one."""
        while not self._ready:
            self._ready = list(next(self._packets).decode())
        return self._ready.pop(0)


def open_container(path: Path) -> Any:
    """A media file; raises CameraError if it is gone or can't be read."""
    if not path.is_file():
        raise CameraError(f"the video {path} is gone")
    try:
        return av.open(str(path))
    except (av.error.FFmpegError, OSError) as error:
        why = error.strerror or type(error).__name__
        raise CameraError(f"{path} can't be read as a video ({why}); it is damaged or of an unknown format") from error


def exact_ns(pts: int, time_base: Any) -> int:
    """A time stamp in ns, without the detour over a float."""
    return int(pts * time_base.numerator * _NS // time_base.denominator)


def bgr_of(frame: Any) -> Colour:
    """A decoded frame upright as (H, W, 3) uint8 BGR; a phone's recording says how it was held."""
    bgr = frame.to_ndarray(format="bgr24")
    turns = round((getattr(frame, "rotation", 0) or 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(bgr, turns) if turns else bgr)
