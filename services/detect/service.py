"""The detect process: from frames to markers.

Consumes  FRAME, CAMERA, SHARES, RECORDING (a recorded camera's frames wait their turn); the pixels in the cameras'
          rings, in place.
Produces  DETECTIONS (source ``markers``) for each frame that it looked at, with the account of those it didn't.
States    running.
"""

from __future__ import annotations

from collections.abc import Iterator

from common import clock
from common.bus import Poller, Publisher, Subscriber
from common.markers import family
from common.messages import MARKERS, CameraState, DetectedMarker, Detections, FrameAnnounced, RecordingState, Shares
from common.service import Context, Report
from common.service.meters import Percentiles, Rate
from common.topics import CAMERA, DETECTIONS, FRAME, RECORDING, SHARES
from services.detect.cameras import Camera
from services.detect.markers import MarkerDetector, open_detector
from services.detect.markers.base import Grey
from services.detect.tracking import Tracker


class DetectService:
    """One detect process; several share the cameras by camera, never by frame.

    Always the newest frame of a camera (while it is recorded, its next one), and the cameras in turn: of those that
    have a frame waiting, the one that was served longest ago is next. While none waits, frames that were only followed
    are searched, a piece at a time.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._log = context.log
        self._config = context.rig.config
        self._cameras: dict[str, Camera] = {}
        self._trackers: dict[str, tuple[str, Tracker]] = {}
        self._searches: dict[str, Iterator[None]] = {}
        self._turn: list[str] = []
        self._shares: Shares | None = None
        self._rate = Rate()
        self._latency_ns = Percentiles()
        self._took_ns = Percentiles()
        self._subscriber: Subscriber | None = None
        self._publisher: Publisher | None = None

    def open(self) -> None:
        """Open the detectors and connect to the bus; raises ConfigError for an unusable marker family."""
        context = self._context
        folder, chosen = context.rig.folder, self._config.markers.detector
        markers = family(self._config.markers.family, folder)
        self._fast: MarkerDetector = open_detector(markers, folder, detector=chosen)
        self._thorough: MarkerDetector = open_detector(markers, folder, thorough=True, detector=chosen)
        self._publisher = Publisher(context.endpoints, context.id, context.boot)
        self._subscriber = Subscriber(context.endpoints)
        self._subscriber.subscribe(FRAME, every=True)
        for topic in (CAMERA, SHARES, RECORDING):
            self._subscriber.subscribe(topic)
        self._poller = Poller(self._subscriber)

    def step(self, timeout_s: float) -> None:
        """One round: the news, then one frame of the camera whose turn it is."""
        waiting = any(camera.ready for camera in self._served())
        self._poller.wait(0.0 if waiting or self._searches else timeout_s)
        self._listen()
        self._forget_silent()
        camera = next((camera for camera in self._served() if camera.ready), None)
        if camera is not None:
            self._turn.remove(camera.name)
            self._turn.append(camera.name)
            self._next_frame(camera)
        elif self._searches:
            self._search_on(next(iter(self._searches)))

    def drain(self) -> bool:
        """Nothing is under way between two rounds."""
        return True

    def close(self) -> None:
        """Unmap the rings, close the sockets; idempotent."""
        for camera in self._cameras.values():
            camera.unmap()
        for part in (self._subscriber, self._publisher):
            if part is not None:
                part.close()
        self._subscriber = self._publisher = None

    def report(self) -> Report:
        """What the heartbeat says: rates a camera, frames passed over by reason, latency from capture on."""
        dropped: dict[str, int] = {}
        for camera in self._cameras.values():
            for reason, count in camera.skipped.as_dict().items():
                dropped[reason] = dropped.get(reason, 0) + count
        if self._subscriber is not None and self._subscriber.bad:
            dropped["garbage"] = self._subscriber.bad
        if self._publisher is not None and self._publisher.dropped:
            dropped["bus_full"] = self._publisher.dropped
        present = [camera for camera in self._served() if camera.state is not None]
        rates = {f"detected/{camera.name}": camera.rate.per_second() for camera in present}
        return Report(
            cameras=tuple(sorted(camera.name for camera in present)),
            rates={"detected": self._rate.per_second(), **rates},
            dropped=dropped,
            numbers=self._numbers(),
        )

    def _numbers(self) -> dict[str, float]:
        if not len(self._took_ns):
            return {}
        return {
            "latency_p50_ms": self._latency_ns.at(50) / 1e6,
            "latency_p99_ms": self._latency_ns.at(99) / 1e6,
            "took_p50_ms": self._took_ns.at(50) / 1e6,
            "took_p99_ms": self._took_ns.at(99) / 1e6,
        }

    # --- news -----------------------------------------------------------------------------------------

    def _listen(self) -> None:
        assert self._subscriber is not None
        now = clock.monotonic_ns()
        for received in self._subscriber.receive():
            match received.message:
                case FrameAnnounced(ref=ref):
                    self._camera(ref.camera).announced(ref, now)
                case CameraState() as state:
                    self._hear_camera(state, now)
                case RecordingState(camera=name, ledger=ledger):
                    self._camera(name).recorded(ledger.phase == "running", now)
                case Shares() as shares:
                    self._shares = shares
                    self._hand_over()

    def _hear_camera(self, state: CameraState, now: int) -> None:
        camera = self._camera(state.camera.name)
        if camera.state is None and self._serves(camera.name):
            self._log.info("camera.known", camera=camera.name, paced=state.paced)
        camera.heard(state, now)

    def _camera(self, name: str) -> Camera:
        if name not in self._cameras:
            self._cameras[name] = Camera(name)
            self._turn.append(name)
        return self._cameras[name]

    def _serves(self, name: str) -> bool:
        if self._config.workers.detect == 1:
            return True
        return self._shares is not None and self._shares.detect.get(name) == self._context.instance

    def _served(self) -> list[Camera]:
        """The cameras that this instance serves, the one that was served longest ago first."""
        return [self._cameras[name] for name in self._turn if self._serves(name)]

    def _hand_over(self) -> None:
        """Let go of the rings of cameras that another instance serves."""
        for camera in self._cameras.values():
            if not self._serves(camera.name):
                camera.handed_over()
                self._searches.pop(camera.name, None)

    def _forget_silent(self) -> None:
        now = clock.monotonic_ns()
        for camera in self._cameras.values():
            if camera.state is not None and camera.gone(now):
                camera.forget()
                self._searches.pop(camera.name, None)
                self._log.info("camera.vanished", camera=camera.name)

    # --- frames ---------------------------------------------------------------------------------------

    def _next_frame(self, camera: Camera) -> None:
        began = clock.monotonic_ns()
        ref = camera.next(began, self._config.ring.slots)
        if ref is None:
            return
        self._searches.pop(camera.name, None)  # its pixels are about to be those of this frame
        grey = camera.grey(ref)
        if grey is None:
            return
        markers = tuple(self._thorough.detect(grey) if camera.patient else self._tracked(camera, grey))
        now = clock.monotonic_ns()
        self._publish(
            camera, Detections(ref=ref, markers=markers, took_ns=now - began, skipped=camera.skipped.as_dict())
        )
        camera.rate.mark()
        self._rate.mark()
        self._took_ns.add(now - began)
        self._latency_ns.add(now - ref.captured_mono_ns)

    def _tracked(self, camera: Camera, grey: Grey) -> list[DetectedMarker]:
        """The frame's markers; a camera that waits for its labels has the time to be searched in between."""
        tracker = self._tracker(camera)
        live = camera.state is not None and not camera.state.paced
        found = tracker.detect(grey, later=live)
        if tracker.owes_search:
            self._searches[camera.name] = tracker.look_around(grey)
        return found

    def _search_on(self, name: str) -> None:
        """A piece of the search that a camera's last frame is owed."""
        try:
            next(self._searches[name])
        except StopIteration:
            del self._searches[name]

    def _tracker(self, camera: Camera) -> Tracker:
        """The camera's own; a new life of the camera begins anew."""
        ring = camera.state.ring if camera.state is not None else ""
        known = self._trackers.get(camera.name)
        if known is None or known[0] != ring:
            known = self._trackers[camera.name] = (ring, Tracker(self._fast))
        return known[1]

    def _publish(self, camera: Camera, detections: Detections) -> None:
        assert self._publisher is not None
        self._publisher.publish(DETECTIONS, (camera.name, MARKERS), detections)
