"""The capture service: one camera, its ring, its announcements.

Consumes RECORDING (a file camera plays when one begins) and LABELS (a paced one waits for them; others soon don't ask).
Produces FRAME, TRUTH and CAMERA. The states of the camera are in ``announcer.NEXT_PHASES``.
"""

from __future__ import annotations

from common.bus import Poller, Publisher, Subscriber
from common.config.models import CameraConfig
from common.errors import ConfigError
from common.geometry import CameraModel
from common.labels import CameraLabel
from common.messages import Labels, RecordingState
from common.service import Context, Report
from common.topics import LABELS, RECORDING
from services.capture.announcer import Announcer
from services.capture.cameras.intrinsics import label_of
from services.capture.cameras.registry import load_driver
from services.capture.cues import Cues
from services.capture.grabber import Grabber
from services.capture.last_life import SUFFIX, LastLife
from services.capture.rings import Rings

STALE_S = 5.0
UNKNOWN_SIZE = (1280, 720)
UNKNOWN_FPS = 30.0


class CaptureService:
    """See the module; the grab thread does the work, this loop listens and repeats the state."""

    def __init__(self, context: Context) -> None:
        if context.camera is None:
            raise ConfigError("capture serves one camera; name it with --camera")
        self._context = context
        self._name = context.camera
        self._cues = Cues(context.boot)
        self._publisher: Publisher | None = None
        self._subscriber: Subscriber | None = None
        self._announcer: Announcer | None = None
        self._grabber: Grabber | None = None
        self._life: LastLife | None = None

    def open(self) -> None:
        """Find the driver (ConfigError if it can't be used), start grabbing; the runner has swept dead rings."""
        context, name = self._context, self._name
        extra = context.args.camera_file
        rig = context.rig if extra is None else context.rig.with_camera_file(extra)
        config = rig.camera(name)
        driver = load_driver(config.driver)
        self._publisher = Publisher(context.endpoints, context.id, context.boot)
        self._subscriber = Subscriber(context.endpoints)
        self._subscriber.subscribe(RECORDING, name)
        self._subscriber.subscribe(LABELS, name)
        unopened = rig.calibration(name) or _placeholder(name, config)
        fps = config.fps or UNKNOWN_FPS
        self._announcer = Announcer(self._publisher, context.boot, config.driver, unopened, fps)
        rings = Rings(context.endpoints.prefix, context.id, context.boot, rig.config.ring.slots)
        log = context.log.bind(camera=name)
        life = LastLife(context.endpoints.run_dir / f"{context.id}{SUFFIX}", name, config.driver, log)
        self._life = life
        open_camera = life.guard(lambda: driver(name, config, rig))
        attempts = life.died.count - 1 if life.died else 0
        self._grabber = Grabber(open_camera, self._announcer, rings, self._cues, context.boot, log, attempts=attempts)
        self._poller = Poller(self._subscriber)
        self._announcer.repeat()
        self._grabber.start()

    def step(self, timeout_s: float) -> None:
        """Pass on what concerns the grab thread; repeat the camera's state."""
        assert self._subscriber is not None
        assert self._announcer is not None
        assert self._grabber is not None
        if self._grabber.failure is not None:
            raise self._grabber.failure
        self._grabber.watchdog.look()
        if self._announcer.unpaced:
            self._subscriber.unsubscribe(LABELS, self._name)
        self._poller.wait(timeout_s)
        for received in self._subscriber.receive(max_age_s=STALE_S):
            if isinstance(received.message, Labels):
                self._cues.on_labelled(received.message.ref)
            elif isinstance(received.message, RecordingState):
                self._cues.on_recording(received.message)
        self._announcer.repeat()

    def drain(self) -> bool:
        """Nothing that was begun has to be finished."""
        return True

    def close(self) -> None:
        """Stop grabbing, remove the ring; idempotent."""
        if self._grabber is not None:
            self._grabber.stop()
            self._grabber = None
        if self._life is not None:
            self._life.end()
            self._life = None
        for owner in (self._publisher, self._subscriber):
            if owner is not None:
                owner.close()
        self._publisher = self._subscriber = None

    def report(self) -> Report:
        """For the heartbeat."""
        return Report(cameras=(self._name,)) if self._announcer is None else self._announcer.report()


def _placeholder(name: str, config: CameraConfig) -> CameraLabel:
    """How a camera is described that was never open: a guess of the configured size."""
    width, height = config.width or UNKNOWN_SIZE[0], config.height or UNKNOWN_SIZE[1]
    return label_of(name, CameraModel.guess(width, height), intrinsics_from="guess")
