"""One viewer's socket: what it wishes comes in, pictures and state go out. One task sends, so nothing overtakes."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from common import clock
from common.ids import NAME_PATTERN
from services.console.encode import Kind
from services.console.feeds import Feeds, Picture
from services.console.hub import StateHub
from services.console.metrics import Metrics
from services.console.pacing import Pacing

VERSION = 1
MOST_VIEWS = 32
SILENT_S = 30.0
"""A viewer that has said nothing (not even ping) for so long is gone."""
SEND_S = 30.0
_LARGEST_SIDE = 16384


class _Said(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Hello(_Said):
    """The first message."""

    t: Literal["hello"]
    v: int


class Wish(_Said):
    """One view: ``width`` in device pixels."""

    id: str = Field(min_length=1, max_length=40)
    camera: str = Field(pattern=NAME_PATTERN)
    kind: Kind
    width: int = Field(ge=1, le=_LARGEST_SIDE)


class Watch(_Said):
    """The whole wish, each time."""

    t: Literal["watch"]
    views: tuple[Wish, ...] = Field(max_length=MOST_VIEWS)
    visible: bool


class Ack(_Said):
    """Picture ``seq`` of view ``id`` was drawn."""

    t: Literal["ack"]
    id: str
    seq: int


class Ping(_Said):
    """A sign of life."""

    t: Literal["ping"]


SAID: TypeAdapter[Hello | Watch | Ack | Ping] = TypeAdapter(Hello | Watch | Ack | Ping)
"""What a page may say."""


class ShownView:
    """A view of this viewer: its pacing and its slot, which holds one picture, the newest."""

    def __init__(self, viewer: Viewer, wish: Wish) -> None:
        self.wish = wish
        self.pacing = Pacing(wish.width)
        self.slot: Picture | None = None
        self._viewer = viewer

    def wants(self, source_width: int) -> int | None:
        """See feeds.View."""
        now = clock.monotonic_ns()
        if self.slot is not None or not self.pacing.ready(now):
            return None
        return self.pacing.divisor(source_width)

    def offer(self, picture: Picture) -> None:
        """See feeds.View."""
        self.slot = picture
        self._viewer.wake()


class Viewer:
    """One connected page."""

    def __init__(self, socket: WebSocket, feeds: Feeds, hub: StateHub, measured: Metrics) -> None:
        self._socket = socket
        self._feeds = feeds
        self._hub = hub
        self._measured = measured
        self._views: dict[str, ShownView] = {}
        self._awake = asyncio.Event()
        self._told: dict[str, int] = {}
        self._event = hub.last_event
        self._greeted = False
        self._texts: list[str] = []
        self._bye: str | None = None
        self.sent = 0

    async def serve(self) -> None:
        """Until the viewer leaves."""
        self._hub.add(self)
        sender = asyncio.create_task(self._send_all(), name="viewer-send")
        listener = asyncio.create_task(self._listen(), name="viewer-listen")
        try:
            await asyncio.wait({sender, listener}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._hub.remove(self)
            self._watch(())
            for task in (sender, listener):
                task.cancel()
            await asyncio.gather(sender, listener, return_exceptions=True)

    def wake(self) -> None:
        """There is something to send."""
        self._awake.set()

    def end(self, why: str) -> None:
        """Say good-bye and close."""
        self._bye = self._bye or why
        self.wake()

    # --- what it says -------------------------------------------------------------------------------------

    async def _listen(self) -> None:
        try:
            while self._bye is None:
                text = await asyncio.wait_for(self._socket.receive_text(), SILENT_S)
                self._hear(text)
        except TimeoutError:
            self.end(f"nothing was heard of this page for {SILENT_S:g} s")
            await asyncio.sleep(SEND_S)  # the sender says good-bye and ends this task
        except (WebSocketDisconnect, KeyError):  # KeyError: a binary message, which nobody sends
            return

    def _hear(self, text: str) -> None:
        try:
            said = SAID.validate_json(text)
        except ValidationError:
            self.end("that is no message of this protocol")
            return
        match said:
            case Hello(v=version):
                if version != VERSION:
                    self.end(f"this page speaks version {version}, the console {VERSION}: reload the page")
                self._greeted = True
                self.wake()
            case Watch(views=views, visible=visible):
                self._watch(views if visible else ())
            case Ack(id=view, seq=seq):
                self._acknowledged(view, seq)
            case Ping():
                self._texts.append('{"t":"pong"}')
                self.wake()

    def _watch(self, wishes: tuple[Wish, ...]) -> None:
        wanted = {wish.id: wish for wish in wishes}
        now = clock.monotonic_ns()
        old = [view for view in self._views.values() if wanted.get(view.wish.id) != view.wish or view.pacing.stuck(now)]
        for view in old:
            del self._views[view.wish.id]
            self._feeds.leave(view.wish.camera, view.wish.kind, view)
        for wish in wanted.values():
            if wish.id not in self._views:
                view = self._views[wish.id] = ShownView(self, wish)
                self._feeds.join(wish.camera, wish.kind, view)

    def _acknowledged(self, name: str, seq: int) -> None:
        view = self._views.get(name)
        took_ns = None if view is None else view.pacing.acknowledged(seq, clock.monotonic_ns())
        if view is None or took_ns is None:
            return
        self._measured.drawn.observe(took_ns / 1e9)
        if view.slot is not None:
            self.wake()

    # --- what it is told ----------------------------------------------------------------------------------

    async def _send_all(self) -> None:
        try:
            while True:
                await self._awake.wait()
                self._awake.clear()
                if self._bye is not None:
                    await self._text(json.dumps({"t": "bye", "why": self._bye}))
                    await self._socket.close()
                    return
                for text in self._news():
                    await self._text(text)
                for view in list(self._views.values()):
                    await self._picture(view)
        except (WebSocketDisconnect, TimeoutError, RuntimeError):  # gone, or takes nothing any more
            return

    def _news(self) -> list[str]:
        texts, self._texts = self._texts, []
        if not self._greeted:
            return texts
        for event in self._hub.events_after(self._event):
            texts.append(event.text)
            self._event = event.n
        for topic, (version, text) in self._hub.topics.items():
            if self._told.get(topic) != version:
                self._told[topic] = version
                texts.append(text)
        return texts

    async def _picture(self, view: ShownView) -> None:
        now = clock.monotonic_ns()
        if view.slot is None or not view.pacing.ready(now):
            return
        picture, view.slot = view.slot, None
        self.sent += 1
        view.pacing.sent(self.sent, now)
        head: dict[str, Any] = {
            "id": view.wish.id,
            "seq": self.sent,
            "sent_ns": now,
            "age_ms": round((now - picture.captured_ns) / 1e6, 1),
            "reduced": view.pacing.reduced,
        }
        header = json.dumps(head, separators=(",", ":")).encode()[:-1] + b"," + picture.tail + b"}"
        self._measured.sent.labels(view.wish.kind).observe((now - picture.captured_ns) / 1e9)
        data = b"".join((struct.pack("<I", len(header)), header, picture.jpeg))
        await asyncio.wait_for(self._socket.send_bytes(data), SEND_S)

    async def _text(self, text: str) -> None:
        await asyncio.wait_for(self._socket.send_text(text), SEND_S)
