"""An Azure Kinect's recording (``.mkv``): colour, depth aligned to it, the factory's calibration, exact times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np

from common.errors import CameraError
from services.capture.cameras.azure_calibration import Reprojection, read_calibration
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.exact_videos import Decoded, bgr_of, exact_ns, open_container
from services.capture.cameras.file_sources import FileFrame, Recorded
from services.capture.cameras.nearest import Nearest
from services.capture.cameras.pictures import Depth

PAIR_NS = 17_000_000
"""Depth belongs to a colour frame that is at most this far in time: half a period of the camera at 30 frames/s."""
_CALIBRATION = "calibration.json"


class AzureSource:
    """See Source. Depth is mm; a frame whose depth wasn't recorded has none. Raises CameraError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._containers: list[Any] = []
        self.fps: float | None = None
        self._index = 0
        self.recorded = Recorded()
        self._reprojection: Reprojection | None = None
        self.rewind(0)

    def read(self) -> FileFrame | None:
        """See Source."""
        index = self._index
        try:
            colour = next(self._colours, None)
            if colour is None:
                return None
            self._index += 1
            depth = self._depth_at(_time(colour))
        except av.error.FFmpegError as error:
            self._index = index + 1
            raise FrameSkippedError(f"{self._path.name}#{index} is damaged: {error.strerror}", "unreadable") from error
        return FileFrame(bgr_of(colour), depth, self._began_ns + _time(colour), f"{self._path.name}#{index}")

    def rewind(self, frame: int) -> None:
        """See Source."""
        self.close()
        self._containers = [open_container(self._path) for _ in range(2)]  # two, since the tracks are read apart
        try:
            colour, depth = (self._track(self._containers[0], "COLOR"), self._track(self._containers[1], "DEPTH"))
            if colour is None:
                raise CameraError(f"{self._path} has no colour track; tagmill needs one")
            self._learn(colour, depth)
        except CameraError:
            self.close()
            raise
        self._colours = Decoded(self._containers[0], colour)
        self._depths: Nearest[Any] | None = (
            None if depth is None else Nearest((_time(frame), frame) for frame in Decoded(self._containers[1], depth))
        )
        self._index = 0
        while self._index < frame and next(self._colours, None) is not None:
            self._index += 1

    def close(self) -> None:
        """See Source."""
        for container in self._containers:
            container.close()
        self._containers = []

    def _learn(self, colour: Any, depth: Any) -> None:
        """What the file says of the camera; the same at each rewind."""
        rate = float(colour.average_rate or 0)
        self.fps = rate if rate > 0 else None
        tags = colour.container.metadata
        self._began_ns = int(tags.get("K4A_START_OFFSET_NS", 0))
        text = next((one.data for one in colour.container.streams.attachments if one.name == _CALIBRATION), None)
        if text is None:
            raise CameraError(f"{self._path} lacks its calibration ({_CALIBRATION}); it was not made by k4arecorder")
        # Without depth pictures the depth camera's mode is of no matter; any will do.
        size = (640, 576) if depth is None else (depth.width, depth.height)
        calibration = read_calibration(bytes(text), (colour.width, colour.height), size)
        if self._reprojection is None and depth is not None:
            self._reprojection = Reprojection(calibration)
        unit = None if depth is None else 1.0
        self.recorded = Recorded(calibration.colour, unit, tags.get("K4A_DEVICE_SERIAL_NUMBER"))

    def _depth_at(self, colour_ns: int) -> Depth | None:
        """The depth picture nearest to a colour frame, aligned to it; None if none is near enough."""
        if self._depths is None or self._reprojection is None:
            return None
        frame = self._depths.at(colour_ns, PAIR_NS)
        if frame is None:
            return None
        return self._reprojection.align(np.ascontiguousarray(frame.to_ndarray(), dtype=np.uint16))

    def _track(self, container: Any, title: str) -> Any:
        return next((one for one in container.streams.video if one.metadata.get("title") == title), None)


def _time(frame: Any) -> int:
    return exact_ns(frame.pts, frame.time_base)
