"""Asking an ASGI application without a server: what it answers, as a client would see it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import MutableMapping
from typing import Any, NamedTuple

from services.console.guard import Application


class Answered(NamedTuple):
    """An HTTP answer."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


def ask(
    app: Application, method: str, target: str, body: bytes = b"", host: str = "127.0.0.1:8750", **headers: str
) -> Answered:
    """One HTTP request; a header ``content_type`` is sent as ``content-type``."""
    path, _, query = target.partition("?")
    sent: list[MutableMapping[str, Any]] = []
    given = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": query.encode(),
        "scheme": "http",
        "headers": [(b"host", host.encode()), *given],
    }

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    answered = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return Answered(sent[0]["status"], answered, b"".join(part.get("body", b"") for part in sent[1:]))


def knock(app: Application, host: str = "127.0.0.1:8750", **headers: str) -> list[MutableMapping[str, Any]]:
    """A WebSocket's handshake at /ws; what the application sends."""
    sent: list[MutableMapping[str, Any]] = []
    given = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": "websocket", "path": "/ws", "query_string": b"", "headers": [(b"host", host.encode()), *given]}

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "websocket.connect"}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    return sent
