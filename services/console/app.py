"""The console put together: routes in the order of their guards, and the ticks of its life."""

from __future__ import annotations

import asyncio

from fastapi import FastAPI, Response, WebSocket
from starlette.responses import FileResponse, JSONResponse, RedirectResponse

from common import VERSION, clock
from common.bus import Received
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
from services.console.feeds import Feeds
from services.console.guard import Application, Guard, Rules
from services.console.hub import StateHub
from services.console.line import Line, Plain
from services.console.page import Page
from services.console.rest import refusal, router
from services.console.state import State
from services.console.viewer import Viewer

MOST_VIEWERS = 16
TICK_S = 0.2
STATUS_EVERY_S = 1.0
STATUS_S = 3.0
PREVIEW_S = 5.0
LEASE_EVERY_S = 2.0
VIEWS = ("live", "coverage", "health", "setup", "gallery")


class Console:
    """Everything between the line to the stack and the pages."""

    def __init__(self, context: Context, loop: asyncio.AbstractEventLoop, rules: Rules) -> None:
        self._context = context
        self._loop = loop
        keys = context.rig.config.network.keys
        keys_dir = context.rig.resolve(keys) if keys else None
        self.hub = StateHub()
        self.state = State(self.hub)
        self.line = Line(context.endpoints, keys_dir, loop, self._hear)
        self.feeds = Feeds(loop, self.state.why_no_label, self._listen)
        self.page = Page()
        self.guard = Guard(self._routes(), rules, self.page.hashes)
        self._turned_away = 0
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def asgi(self) -> Application:
        """What uvicorn serves."""
        return self.guard

    def start(self) -> None:
        """Listen, and begin to tick."""
        for topic in (SERVICE, CAMERA, RECORDING, SAMPLES, LABELS):
            self.line.subscribe(topic)
        self.line.start()
        for name, work in (("tick", self._tick()), ("status", self._ask_status()), ("leases", self._renew_leases())):
            task = self._loop.create_task(work, name=name)
            task.add_done_callback(_raise)
            self._tasks.append(task)

    def farewell(self) -> None:
        """The pages are told that the console ends; the recording goes on."""
        self.hub.end_all("the console is being stopped; a recording goes on without it")

    def close(self) -> None:
        """End ticks and threads; idempotent."""
        for task in self._tasks:
            task.cancel()
        self.line.close()
        self.feeds.close()

    def report(self, url: str) -> Report:
        """What the heartbeat says."""
        dropped = {f"picture:{reason}": count for reason, count in self.feeds.skipped.as_dict().items()}
        dropped |= {f"bus:{kind}": count for kind, count in self.line.bad.items()}
        numbers = {"viewers": float(self.hub.viewers), "refused": float(self.guard.refused)}
        return Report(
            rates={"pictures": self.feeds.encoded.per_second()}, dropped=dropped, numbers=numbers, texts={"url": url}
        )

    # --- life ---------------------------------------------------------------------------------------------

    async def _tick(self) -> None:
        while True:
            self.state.tick()
            await asyncio.sleep(TICK_S)

    async def _ask_status(self) -> None:
        while True:
            if self.hub.viewers:
                self.state.heard_status(await self.line.ask({"command": "status"}, STATUS_S))
            await asyncio.sleep(STATUS_EVERY_S)

    async def _renew_leases(self) -> None:
        while True:
            for camera in self.feeds.previews_wanted():
                await self.line.ask({"command": "preview", "camera": camera}, PREVIEW_S)
            await asyncio.sleep(LEASE_EVERY_S)

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
                    self.state.hear_samples(changed)

    # --- routes -------------------------------------------------------------------------------------------

    def _routes(self) -> FastAPI:
        app = FastAPI(title="tagmill console", version=VERSION, docs_url=None, redoc_url=None)
        app.include_router(router(self._command))
        app.add_api_route("/api/status", self._status, methods=["GET"], response_model=None)
        app.add_api_route("/api/events", self._events, methods=["GET"], response_model=None)
        app.add_api_route("/healthz", self._healthz, methods=["GET"], response_model=None)
        for name in VIEWS:
            app.add_api_route(f"/{name}", self._index, methods=["GET"], include_in_schema=False, response_model=None)
        app.add_api_route("/", self._root, methods=["GET"], include_in_schema=False, response_model=None)
        app.add_api_route(
            "/static/{name:path}", self._static, methods=["GET"], include_in_schema=False, response_model=None
        )
        app.add_api_websocket_route("/ws", self._socket)
        return app

    async def _command(self, fields: Plain, limit_s: float) -> Plain:
        if fields["command"] != "record":
            return await self.line.ask(fields, limit_s)
        number = self.state.record.asked(fields)
        self.state.tick()
        answer: Plain = {}
        try:
            answer = await self.line.ask(fields, limit_s)
        finally:
            self.state.record.answered(number, answer, clock.monotonic_ns())
        error = answer.get("error")
        if error:
            self.hub.happened("refused", error["message"], code=error["code"], camera=fields.get("camera"))
        self.state.tick()
        return answer

    async def _status(self) -> Response:
        answer = await self.line.ask({"command": "status"}, STATUS_S)
        return JSONResponse(answer, 200 if answer.get("ok") else 503)

    async def _events(self, after: int = 0) -> Response:
        events = [event.fields for event in self.hub.events_after(after)]
        return JSONResponse({"events": events, "last": self.hub.last_event})

    async def _healthz(self) -> Response:
        alive = any(name == "control" and self.state.alive(name) for name in self.state.liveness.seen())
        return JSONResponse({"ok": alive}, 200 if alive else 503)

    async def _root(self) -> Response:
        return RedirectResponse("/live", 307)

    async def _index(self) -> Response:
        if self.page.index is None:
            return refusal(503, "no_page", "the page's files are missing from this installation")
        return FileResponse(self.page.index.path, headers={"cache-control": "no-cache"})

    async def _static(self, name: str) -> Response:
        found = self.page.files.get(name)
        if found is None:
            return refusal(404, "not_found", "there is no such file")
        return FileResponse(found.path, media_type=found.media_type, headers={"cache-control": "no-cache"})

    async def _socket(self, socket: WebSocket) -> None:
        await socket.accept()
        if self.hub.viewers >= MOST_VIEWERS:
            self._turned_away += 1
            await socket.send_json({"t": "bye", "why": f"{MOST_VIEWERS} pages are open already; close one of them"})
            await socket.close(1013)
            return
        await Viewer(socket, self.feeds, self.hub).serve()


def _raise(task: asyncio.Task[None]) -> None:
    """A tick that ends is a bug: asyncio's handler logs it."""
    if not task.cancelled() and (error := task.exception()) is not None:
        raise error
