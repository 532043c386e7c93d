"""The ``files`` driver: pictures or a video from disk, played like a camera."""

from __future__ import annotations

from common.config import Rig
from common.config.models import CameraConfig, FilesOptions
from common.errors import CameraError
from common.labels import CameraLabel
from services.capture.cameras.base import Description, EndOfStreamError, FrameSkippedError, Grabbed
from services.capture.cameras.file_opening import open_source
from services.capture.cameras.file_sources import FileFrame, Source
from services.capture.cameras.intrinsics import known_or_guessed, label_of
from services.capture.cameras.options import read_options
from services.capture.cameras.pacing import Pacer

PICTURES_PER_S = 10.0
"""At which rate pictures are shown that name none themselves."""


class FilesCamera:
    """Plays files; see ``FilesOptions`` for its keys. Raises ConfigError, CameraError as a driver does.

    Without ``loop`` and with ``begin: on_start`` it waits for a recording and then plays from frame 0. With
    ``pace: consumer`` it gives frames as fast as they are asked for and says so in its description.
    A picture that can't be read is skipped as ``unreadable``, one that doesn't fit the calibration as ``wrong_size``.
    """

    def __init__(self, name: str, config: CameraConfig, rig: Rig) -> None:
        self._name = name
        self._config = config
        self._options = read_options(name, config, FilesOptions)
        self._calibration = rig.calibration(name)
        depth_path = None if self._options.depth_path is None else rig.resolve(self._options.depth_path)
        source = open_source(name, rig.resolve(self._options.path), depth_path, self._options)
        self._source: Source | None = source
        self._recorded = source.recorded
        self._depth_unit_mm = self._recorded.depth_unit_mm if depth_path is None else self._options.depth_unit_mm
        self._known: dict[tuple[int, int], Description] = {}
        self._fps = config.fps or source.fps or PICTURES_PER_S
        self._pacer = Pacer(self._fps)
        self._delivered = False
        self._first_ns = self._newest_ns = 0
        self._earlier_loops_ns = 0
        try:
            self._description = self._describe_first(source)
            source.rewind(0)
        except CameraError:
            self.close()
            raise

    def grab(self, timeout_s: float) -> Grabbed:
        """See Camera."""
        source = self._opened()
        if self._options.pace == "fps" and not self._pacer.wait(timeout_s):
            raise TimeoutError(f"{self._name}: the next frame is due later ({self._fps:g} frames/s)")
        frame = source.read()
        if frame is None and self._options.loop and self._delivered:
            self._delivered = False
            self._earlier_loops_ns = self._newest_ns + int(1e9 / self._fps) - self._first_ns
            source.rewind(0)
            frame = source.read()
        if frame is None:
            raise EndOfStreamError(f"{self._name}: all of {self._options.path} was played")
        self._description = self._fitting(frame)
        begins, self._delivered = not self._delivered, True
        if frame.device_ns is None:
            return Grabbed(frame.bgr, frame.depth, None, frame.name)
        if begins:
            self._first_ns = frame.device_ns
        self._newest_ns = self._earlier_loops_ns + frame.device_ns
        return Grabbed(frame.bgr, frame.depth, self._newest_ns, frame.name)

    def describe(self) -> Description:
        """See Camera."""
        return self._description

    def rewind(self, frame: int = 0) -> None:
        """See Rewindable."""
        self._opened().rewind(frame)
        self._delivered = False
        self._earlier_loops_ns = 0
        self._pacer.restart()

    def close(self) -> None:
        """See Camera."""
        if self._source is not None:
            self._source.close()
            self._source = None

    def _opened(self) -> Source:
        if self._source is None:
            raise CameraError(f"camera {self._name} is closed")
        return self._source

    def _describe_first(self, source: Source) -> Description:
        """The description that fits the first picture that can be used; CameraError if there is none."""
        first: FrameSkippedError | None = None
        while True:
            try:
                frame = source.read()
                if frame is None:
                    raise CameraError(first.message if first else f"{self._options.path} holds no frame")
                return self._fitting(frame)
            except FrameSkippedError as error:
                first = first or error

    def _fitting(self, frame: FileFrame) -> Description:
        height, width = frame.bgr.shape[:2]
        if (width, height) not in self._known:
            self._known[width, height] = self._describe(width, height, frame.name)
        return self._known[width, height]

    def _describe(self, width: int, height: int, name: str) -> Description:
        wanted = (self._config.width or width, self._config.height or height)
        if wanted != (width, height):
            raise FrameSkippedError(
                f"{name} has {width}x{height} pixels, camera {self._name} is configured for {wanted[0]}x{wanted[1]}; "
                "leave width and height out: files have the size they have",
                "wrong_size",
            )
        camera, warnings = self._intrinsics(width, height, name)
        return Description(
            camera=camera,
            fps=self._fps,
            depth_unit_mm=self._depth_unit_mm,
            paced=self._options.pace == "consumer",
            waits_for_start=not self._options.loop and self._options.begin == "on_start",
            stamps="media",
            warnings=warnings,
        )

    def _intrinsics(self, width: int, height: int, name: str) -> tuple[CameraLabel, tuple[str, ...]]:
        """The calibration's, else what the recording says of its camera, else a guess."""
        calibration, recorded = self._calibration, self._recorded
        if calibration is None and recorded.camera is not None:
            calibration = label_of(self._name, recorded.camera, intrinsics_from="factory", serial=recorded.serial)
        try:
            return known_or_guessed(self._name, calibration, width, height, recorded.serial)
        except CameraError as error:
            raise FrameSkippedError(f"{name}: {error.message}", "wrong_size") from error
