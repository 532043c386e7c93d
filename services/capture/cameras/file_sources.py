"""What the ``files`` driver plays: frames of pictures, videos and recordings; here the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from common.geometry import CameraModel
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.pictures import Colour, Depth, list_pictures, match_depth, read_depth, read_picture


@dataclass(frozen=True, slots=True)
class FileFrame:
    """A frame of a file: pixels as in ``Grabbed``, its time as the file has it (ns, any origin), its name."""

    bgr: Colour
    depth: Depth | None
    device_ns: int | None
    name: str


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a recording says of the camera that made it; a folder of pictures says nothing.

    ``depth_unit_mm``: mm per step of the recording's own depth pictures, None = it has none.
    """

    camera: CameraModel | None = None
    depth_unit_mm: float | None = None
    serial: str | None = None


class Source(Protocol):
    """Frames from files, in order."""

    fps: float | None
    """As the file says, None if it doesn't."""
    recorded: Recorded

    def read(self) -> FileFrame | None:
        """The next frame, None after the last.

        Raises FrameSkippedError for one that can't be read (the next call goes on after it), CameraError if the
        files are gone.
        """

    def rewind(self, frame: int) -> None:
        """Go on at ``frame`` (from 0); raises CameraError if the files are gone."""

    def close(self) -> None:
        """Let go of the files; idempotent."""


class PictureSource:
    """A folder, a glob or a single picture."""

    fps: float | None = None
    recorded = Recorded()

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
        return FileFrame(bgr, depth_for(bgr, depth_file), None, picture.name)

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


def depth_for(bgr: Colour, path: Path | None) -> Depth | None:
    """The depth picture of a frame; raises FrameSkippedError if it can't be read or has another size."""
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
