"""What control has heard of the stack: cameras, services, recordings, and how the cameras are shared out.

Everything in here comes from the bus, so a restarted control knows it again after the next round of heartbeats.
Until then it is not *settled*: nothing is shared out, and commands that need to know more than `help` does wait.
"""

from __future__ import annotations

from dataclasses import dataclass

from common.bus import Endpoints
from common.commands import ALL_CAMERAS
from common.config import Rig
from common.errors import RefusedError
from common.ledgers import Ledger
from common.messages import CameraState, Labels, Message, RecordingState, ServiceState, Shares
from services.control.moments import Moments
from services.control.recordings import Recordings
from services.control.roll_call import RollCall, expected_services
from services.control.shares import Sharing

SETTLE_NS = 1_300_000_000
"""A round of heartbeats: whoever runs has spoken."""
SETTLE_AT_LATEST_NS = 3_000_000_000
CAMERA_GONE_NS = 3_000_000_000
CAMERA_FORGOTTEN_NS = 60_000_000_000


@dataclass(frozen=True, slots=True)
class SeenCamera:
    """A camera's newest description of itself, and when it came."""

    state: CameraState
    seen_ns: int


class Stack:
    """Control's knowledge; `hear` takes what comes from the bus.

    ``reloading``: the rig file is being taken over. ``requests``: `record`s under way that want more than one sample.
    ``session`` is the store's open session, as the store in its life ``surveyed_boot`` told (at first the rig's).
    """

    def __init__(self, rig: Rig, endpoints: Endpoints, now_ns: int) -> None:
        self.rig = rig
        self.endpoints = endpoints
        self.roll_call = RollCall()
        self.recordings = Recordings()
        self.moments = Moments()
        self.cameras: dict[str, SeenCamera] = {}
        self.session = rig.config.dataset.session
        self.surveyed_boot = ""
        self.settled = False
        self.reloading = False
        self.requests = 0
        self._detect = Sharing(rig.config.workers.detect)
        self._label = Sharing(rig.config.workers.label)
        self._since_ns = now_ns

    def hear(self, message: Message, source: str, now_ns: int) -> None:
        """A state from the bus, sent by ``source``."""
        if isinstance(message, CameraState):
            self.cameras[message.camera.name] = SeenCamera(message, now_ns)
        elif isinstance(message, ServiceState):
            self.roll_call.hear(message, now_ns)
            if message.service.startswith("detect."):
                self._detect.learn(message.instance, message.cameras)
            elif message.service.startswith("label."):
                self._label.learn(message.instance, message.cameras)
        elif isinstance(message, Labels):
            self.moments.hear(message)
        elif isinstance(message, RecordingState):
            self.recordings.hear(message, source, now_ns, self.roll_call.beats(source))

    def told(self, ledger: Ledger, camera: str, peer: str, now_ns: int) -> None:
        """What an order's answer says of a recording; its states on the bus come a moment later."""
        state = RecordingState(camera=camera, ledger=ledger)
        self.recordings.hear(state, peer, now_ns, self.roll_call.beats(peer))

    def tick(self, now_ns: int) -> None:
        """Settle when a round of heartbeats is over, share out new cameras, forget what is long gone."""
        age = now_ns - self._since_ns
        complete = not self.roll_call.missing(self._must_speak, now_ns)
        self.settled = self.settled or age >= (SETTLE_NS if complete else SETTLE_AT_LATEST_NS)
        if self.settled:
            self._share_out()
        for name, seen in list(self.cameras.items()):
            if name not in self.rig.config.cameras and now_ns - seen.seen_ns > CAMERA_FORGOTTEN_NS:
                del self.cameras[name]
        self.roll_call.tidy(self.expected, now_ns)
        self.recordings.tidy(now_ns, self.roll_call.beats)

    @property
    def dataset_is_gone(self) -> bool:
        """Whether the store says that its session's folder was taken away."""
        store = self.roll_call.heard.get("store")
        return store is not None and store.state.texts.get("problem") == "no_dataset"

    @property
    def known_cameras(self) -> tuple[str, ...]:
        """The rig's cameras and those that announced themselves."""
        return tuple(sorted({*self.rig.config.cameras, *self.cameras}))

    @property
    def expected(self) -> tuple[str, ...]:
        """The services that should be there."""
        workers = self.rig.config.workers
        return expected_services(self.known_cameras, workers.detect, workers.label)

    @property
    def labels(self) -> tuple[str, ...]:
        """The label processes."""
        return tuple(f"label.{instance}" for instance in range(self.rig.config.workers.label))

    @property
    def _must_speak(self) -> tuple[str, ...]:
        """Services that may know something of cameras and recordings that control has to learn from them."""
        workers = self.rig.config.workers
        return tuple(
            service for service in expected_services((), workers.detect, workers.label) if service != "control"
        )

    @property
    def shares(self) -> Shares:
        """As it goes to the bus."""
        return Shares(detect=self._detect.table, label=self._label.table)

    def _share_out(self) -> None:
        self._detect.share_out(self.known_cameras)
        self._label.share_out(self.known_cameras)

    def label_of(self, camera: str) -> str:
        """The service id of the label process that serves a camera."""
        instance = self._label.instance(camera)
        assert instance is not None, f"{camera} was not shared out"
        return f"label.{instance}"

    def detect_of(self, camera: str) -> str | None:
        """The service id of the detect process that serves a camera, once it is shared out."""
        instance = self._detect.instance(camera)
        return None if instance is None else f"detect.{instance}"

    def refuse_while_reloading(self) -> None:
        """Raise RefusedError ``busy``: what is begun while the rig changes would have labels of both."""
        if self.reloading:
            raise RefusedError("the rig file is being reloaded; ask again in a few seconds", code="busy")

    def chosen(self, camera: str) -> tuple[str, ...]:
        """The cameras that a request means; raises RefusedError ``no_camera`` with the known ones."""
        known = self.known_cameras
        if not known:
            raise RefusedError(
                "no camera is known; name one in the rig file, or start a capture process", code="no_camera"
            )
        if camera != ALL_CAMERAS and camera not in known:
            raise RefusedError(f"there is no camera '{camera}'; known: {', '.join(known)}", code="no_camera")
        self._share_out()
        return known if camera == ALL_CAMERAS else (camera,)

    def take_over(self, rig: Rig) -> None:
        """Go on with a changed rig file (workers and network are the same)."""
        self.rig = rig

    def present(self, camera: str, now_ns: int) -> bool:
        """Whether the camera's capture process speaks."""
        seen = self.cameras.get(camera)
        return seen is not None and now_ns - seen.seen_ns <= CAMERA_GONE_NS
