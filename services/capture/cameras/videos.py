"""Videos through OpenCV: what every installation has. Times are the container's, rounded to its ms."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from common.errors import CameraError
from services.capture.cameras.file_sources import FileFrame, Recorded, depth_for
from services.capture.cameras.pictures import list_pictures


class VideoSource:
    """A video file; frame n's depth picture is the n-th of the depth folder."""

    recorded = Recorded()

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
        depth = depth_for(bgr, self._depths[index] if index < len(self._depths) else None)
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
