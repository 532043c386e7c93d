"""The console put together: what is heard goes to feeds and state, what is due is asked and told."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from pathlib import Path

from common import clock
from common.bus import Received
from common.config import Rig, load_rig
from common.errors import ConfigError
from common.messages import (
    CameraState,
    FrameAnnounced,
    Labels,
    Preview,
    RecordingState,
    SamplesChanged,
    ServiceState,
)
from common.service import Context, Report
from common.topics import CAMERA, FRAME, LABELS, PREVIEW, RECORDING, SAMPLES, SERVICE
from services.console.app import application
from services.console.calibrator import Calibrator
from services.console.catalog import Catalog
from services.console.feeds import Feeds
from services.console.guard import Application, Guard, Rules
from services.console.hub import StateHub
from services.console.line import Line, Plain
from services.console.live import LiveView
from services.console.metrics import Metrics
from services.console.page import Page
from services.console.pictures import Pictures
from services.console.state import State

TICK_S = 0.2
"""State is told at most five times a second."""
STATUS_EVERY_S = 1.0
STATUS_S = 3.0
PREVIEW_S = 5.0
LEASE_EVERY_S = 2.0
CATALOG_EVERY_S = 0.5
SCRAPED_NS = 90_000_000_000
"""After Prometheus has asked, labels are heard for so long, so that its histograms have no gaps."""


class Console:
    """Everything between the line to the stack and the pages."""

    def __init__(self, context: Context, loop: asyncio.AbstractEventLoop, rules: Rules) -> None:
        self._context = context
        self._loop = loop
        self.rig: Rig = context.rig
        keys = context.rig.config.network.keys
        self.line = Line(context.endpoints, context.rig.resolve(keys) if keys else None, loop, self._hear)
        self.hub = StateHub()
        self.catalog = Catalog(self.line.ask)
        self.pictures = Pictures()
        self.calibrator = Calibrator(context.log)
        self.state = State(self.hub)
        self.state.follow(self.rig)
        self.measured = Metrics(self.state)
        self.feeds = Feeds(loop, self.state.why_no_label, self._listen)
        page = Page()
        self._live = LiveView(self.catalog)
        self._guard = Guard(application(self, page, self.command), rules, page.hashes)
        self._tasks: list[asyncio.Task[None]] = []
        self._hears_labels = False
        self._scraped_ns: int | None = None

    @property
    def asgi(self) -> Application:
        """What uvicorn serves."""
        return self._guard

    def start(self) -> None:
        """Listen, and begin to tick."""
        for topic in (SERVICE, CAMERA, RECORDING, SAMPLES):
            self.line.subscribe(topic)
        self.line.start()
        self._every("tick", self._tick())
        self._every("status", self._ask_status())
        self._every("leases", self._renew_leases())
        self._every("catalog", self._keep_catalog())

    def check(self) -> None:
        """Raise the mistake that ended one of the tasks, if any did."""
        for task in self._tasks:
            if task.done() and not task.cancelled():
                task.result()

    async def farewell(self) -> None:
        """The pages are told that the console ends; the recording goes on, a calibration keeps its views."""
        self.hub.end_all("the console is being stopped; a recording goes on without it")
        await self.calibrator.close()

    def close(self) -> None:
        """End tasks and threads; idempotent."""
        for task in self._tasks:
            task.cancel()
        self.line.close()
        self.feeds.close()
        self.pictures.close()

    def report(self, url: str) -> Report:
        """What the heartbeat says."""
        dropped = {f"picture:{reason}": count for reason, count in self.feeds.skipped.as_dict().items()}
        dropped |= {f"bus:{kind}": count for kind, count in self.line.bad.items()}
        numbers = {"viewers": float(self.hub.viewers), "refused": float(self._guard.refused)}
        rates = {"pictures": self.feeds.encoded.per_second()}
        return Report(rates=rates, dropped=dropped, numbers=numbers, texts={"url": url})

    # --- what the routes ask ------------------------------------------------------------------------------

    async def command(self, fields: Plain, limit_s: float) -> Plain:
        """Pass a command on to the command socket; a `record` shows as asked until it is answered."""
        if fields["command"] != "record":
            return await self.line.ask(fields, limit_s)
        number = self.state.record.asked(fields)
        self.state.tick()
        answer: Plain = {}
        try:
            answer = await self.line.ask(fields, limit_s)
        finally:
            self.state.record.answered(number, answer, clock.monotonic_ns())
            self.state.tick()
        error = answer.get("error")
        if error:
            self.hub.happened("refused", error["message"], code=error["code"], camera=fields.get("camera"))
        return answer

    async def status(self) -> Plain:
        """What the command `status` answers, at most a second old."""
        return await self.line.ask({"command": "status"}, STATUS_S)

    def now_of(self, name: str) -> tuple[float, float] | None:
        """From where an object is seen now: azimuth, elevation (deg)."""
        seen = self._live.data(self.state.newest_labels(), {}, self.rig).get(name)
        return None if seen is None else (seen["azimuth"], seen["elevation"])

    def camera_state(self, name: str) -> CameraState | None:
        """What a camera said of itself last."""
        found = self.state.cameras.get(name)
        return None if found is None else found[0]

    def metrics(self) -> bytes:
        """In Prometheus's text format."""
        self._scraped_ns = clock.monotonic_ns()
        return self.measured.text()

    @property
    def healthy(self) -> bool:
        """Whether control is heard."""
        return self.state.alive("control")

    # --- life ---------------------------------------------------------------------------------------------

    def _every(self, name: str, work: Coroutine[None, None, None]) -> None:
        self._tasks.append(self._loop.create_task(work, name=name))

    async def _tick(self) -> None:
        while True:
            self._hear_labels_if_needed()
            self.calibrator.check(clock.monotonic_ns())
            if self.hub.viewers:
                self.hub.tell("calibration", self.calibrator.data())
            if self.hub.viewers and self.state.status:
                self.state.tick()
                self.hub.tell("coverage", self._live.data(self.state.newest_labels(), self.feeds.sharpness, self.rig))
            await asyncio.sleep(TICK_S)

    async def _ask_status(self) -> None:
        while True:
            if self.hub.viewers or self._scraped():
                answer = await self.status()
                self.state.heard_status(answer)
                if answer.get("ok"):
                    self.catalog.heard_session(answer.get("session"))
                    self._follow_rig(str(answer.get("rig_fingerprint")))
                await asyncio.sleep(STATUS_EVERY_S)
            else:
                self.state.status = {}
                await self._wait_for_viewer(STATUS_EVERY_S)

    async def _wait_for_viewer(self, limit_s: float) -> None:
        """Until a page comes (or Prometheus may have asked)."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self.hub.watched.wait(), limit_s)

    async def _renew_leases(self) -> None:
        while True:
            for camera in self.feeds.previews_wanted():
                await self.line.ask({"command": "preview", "camera": camera}, PREVIEW_S)
            await asyncio.sleep(LEASE_EVERY_S)

    async def _keep_catalog(self) -> None:
        while True:
            if self.hub.viewers and self.state.status.get("ok"):
                await self.catalog.refresh()
                session = Path(self.state.status["dataset"]) / str(self.catalog.session)
                self.state.record.seed(self.catalog.stored, await self.pictures.mean_bytes(session, self.catalog))
            await asyncio.sleep(CATALOG_EVERY_S)

    def _follow_rig(self, fingerprint: str) -> None:
        """Control has taken over a changed rig file: read it too."""
        if fingerprint == self.rig.fingerprint:
            return
        try:
            self.rig = load_rig(self.rig.path)
            self.state.follow(self.rig)
        except ConfigError as error:  # it was changed again meanwhile, and not for the better
            self._context.log.warning("console.rig_unreadable", reason=error.message)

    def _scraped(self) -> bool:
        return self._scraped_ns is not None and clock.monotonic_ns() - self._scraped_ns < SCRAPED_NS

    def _hear_labels_if_needed(self) -> None:
        """Labels come with every frame: nobody looking, nobody listening."""
        needed = bool(self.hub.viewers) or self._scraped()
        if needed != self._hears_labels:
            self._hears_labels = needed
            (self.line.subscribe if needed else self.line.unsubscribe)(LABELS)

    def _listen(self, camera: str, wanted: bool) -> None:
        change = self.line.subscribe if wanted else self.line.unsubscribe
        for topic in (FRAME, PREVIEW):
            change(topic, camera)

    def _hear(self, received: list[Received]) -> None:
        for item in received:
            match item.message:
                case FrameAnnounced(ref=ref):
                    self.feeds.hear_frame(ref)
                case Labels() as labels:
                    self.feeds.hear_labels(labels)
                    self.state.hear_labels(labels)
                    self.measured.label(labels)
                case Preview() as preview:
                    self.feeds.hear_preview(preview)
                case CameraState() as camera:
                    self.feeds.hear_camera(camera)
                    self.state.hear_camera(camera)
                case ServiceState() as service:
                    self.state.hear_service(service)
                case RecordingState() as recording:
                    self.state.hear_recording(recording)
                case SamplesChanged() as changed:
                    self.catalog.hear(changed)
                    self.state.hear_samples(changed)
