"""Which cameras this label process serves, learnt from CAMERA and SHARES."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from structlog.typing import FilteringBoundLogger

from common import clock
from common.labels import SourceDetections
from common.messages import CameraState, Detections, FrameRef, Shares
from services.label.cameras import Camera


class Roster:
    """The served cameras. With one label process that is all of them, else those that control gave it."""

    def __init__(self, instance: int, workers: int, slots: int, log: FilteringBoundLogger) -> None:
        self._instance = instance
        self._alone = workers == 1
        self._slots = slots
        self._log = log
        self._shares: Shares | None = None
        self._cameras: dict[str, Camera] = {}

    def __iter__(self) -> Iterator[Camera]:
        return iter(list(self._cameras.values()))

    @property
    def names(self) -> tuple[str, ...]:
        """The served cameras' names, sorted."""
        return tuple(sorted(self._cameras))

    def get(self, camera: str) -> Camera | None:
        """A served camera."""
        return self._cameras.get(camera)

    def states(self) -> dict[str, CameraState]:
        """What each served camera last said of itself."""
        return {name: camera.state for name, camera in self._cameras.items()}

    def may_serve(self, camera: str) -> bool:
        """Whether a camera is this process's, as far as is known: before the first shares any may be."""
        return self._alone or self._shares is None or self._shares.label.get(camera) == self._instance

    @property
    def decided(self) -> bool:
        """Whether it is known which cameras are this process's."""
        return self._alone or self._shares is not None

    def hear_shares(self, shares: Shares) -> None:
        """Control's split; cameras that are another's now are let go."""
        self._shares = shares
        for name in [name for name in self._cameras if not self.may_serve(name)]:
            self._cameras.pop(name).close()

    def hear_camera(self, state: CameraState) -> None:
        """A camera describes itself."""
        name = state.camera.name
        if name in self._cameras:
            self._cameras[name].update(state)
        elif self._alone or (self._shares is not None and self.may_serve(name)):
            self._cameras[name] = Camera(state, self._slots)
            self._log.info("camera.known", camera=name, width=state.camera.width, height=state.camera.height)

    def let_go(self, wanted: Callable[[str], bool]) -> None:
        """Forget cameras that are gone for good, unless somebody ``wanted`` something of them still."""
        now = clock.monotonic_ns()
        for name in [name for name, camera in self._cameras.items() if camera.gone(now) and not wanted(name)]:
            self._cameras.pop(name).close()
            self._log.info("camera.forgotten", camera=name)

    def hear_detections(self, detections: Detections) -> None:
        """Queue them with their camera."""
        camera = self._cameras.get(detections.ref.camera)
        if camera is not None:
            camera.arrived(detections)

    def others(self, ref: FrameRef) -> tuple[SourceDetections, ...]:
        """What sources other than the markers have said of a frame so far."""
        camera = self._cameras.get(ref.camera)
        return () if camera is None else camera.others(ref)

    def close(self) -> None:
        """Unmap all rings."""
        for camera in self._cameras.values():
            camera.close()
