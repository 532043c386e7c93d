"""Pictures to calibrate from: a folder, a pattern of names, or a video."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from common.bounded import TooLargeError, read_bytes
from common.errors import RefusedError
from common.pictures import MOST_BYTES, decode

Grey = NDArray[np.uint8]
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"})
MOST_FRAMES = 300
"""So many frames of a video are looked at, evenly spread."""


@dataclass(frozen=True)
class Pictures:
    """Where pictures come from: either ``files`` or a ``video`` of which ``frames`` are looked at."""

    source: str
    files: tuple[Path, ...] = ()
    video: Path | None = None
    frames: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.files) or len(self.frames)

    def read(self) -> Iterator[tuple[str, Grey | None]]:
        """Name and grey picture of each; None for one that can't be read."""
        if self.video is None:
            for path in self.files:
                yield path.name, _read(path)
            return
        opened = cv2.VideoCapture(str(self.video))
        try:
            wanted, last = set(self.frames), max(self.frames, default=-1)
            for number in range(last + 1):
                if not opened.grab():
                    return
                if number in wanted:
                    good, frame = opened.retrieve()
                    yield f"frame {number}", _grey(np.asarray(frame, dtype=np.uint8)) if good else None
        finally:
            opened.release()


def pictures_of(images: str) -> Pictures:
    """The pictures of a folder or of a pattern like ``shots/left*.jpg``, in natural order. Raises RefusedError."""
    folder = Path(images)
    if folder.is_dir():
        found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
        none = f"{images} holds no picture ({', '.join(sorted(SUFFIXES))})"
    else:
        found = [Path(path) for path in glob.glob(images) if Path(path).is_file()]  # noqa: PTH207 - any pattern, also absolute
        none = f"no file fits {images}; name a folder or a quoted pattern like 'shots/*.jpg'"
    if not found:
        raise RefusedError(none, code="no_picture")
    return Pictures(images, files=tuple(sorted(found, key=lambda path: _natural(path.name))))


def frames_of(video: Path) -> Pictures:
    """At most MOST_FRAMES frames of a video. Raises RefusedError."""
    opened = cv2.VideoCapture(str(video))
    try:
        count = int(opened.get(cv2.CAP_PROP_FRAME_COUNT)) if opened.isOpened() else 0
    finally:
        opened.release()
    if count < 1:
        what = "is no video that can be read" if video.is_file() else "does not exist"
        raise RefusedError(f"{video} {what}; give a video file, or pictures with --images", code="no_picture")
    step = max(1, -(-count // MOST_FRAMES))
    return Pictures(str(video), video=video, frames=tuple(range(0, count, step)))


def _read(path: Path) -> Grey | None:
    try:
        found = decode(read_bytes(path, MOST_BYTES), cv2.IMREAD_GRAYSCALE)
    except (OSError, TooLargeError):
        return None
    return None if found is None else np.asarray(found, dtype=np.uint8)


def _grey(frame: NDArray[np.uint8]) -> Grey:
    return frame if frame.ndim == 2 else np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name.lower())]
