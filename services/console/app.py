"""The console's address space: the page, the commands, what the page reads, and the WebSocket."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, Protocol

from fastapi import FastAPI, Response, WebSocket
from starlette.responses import RedirectResponse

from common import VERSION
from services.console import api, calibration_api, rest
from services.console.feeds import Feeds
from services.console.metrics import Metrics
from services.console.page import Page, StaticFile
from services.console.rest import Ask, refusal
from services.console.viewer import Viewer

MOST_VIEWERS = 16
Route = Callable[..., Coroutine[Any, Any, Response]]

VIEWS = ("live", "coverage", "health", "setup", "gallery")
_FRESH = {"cache-control": "no-cache"}
_TRY_LATER = 1013


class Home(api.Source, calibration_api.Home, Protocol):
    """What the routes need of the console."""

    feeds: Feeds
    measured: Metrics


def application(home: Home, page: Page, command: Ask) -> FastAPI:
    """All routes; without FastAPI's own documentation pages, which load scripts from elsewhere."""
    app = FastAPI(title="tagmill console", version=VERSION, docs_url=None, redoc_url=None)
    app.include_router(rest.router(command))
    app.include_router(api.router(home))
    app.include_router(calibration_api.router(home))
    add_page(app, page)

    @app.websocket("/ws")
    async def socket(connection: WebSocket) -> None:
        await connection.accept()
        if home.hub.viewers >= MOST_VIEWERS:
            await connection.send_json({"t": "bye", "why": f"{MOST_VIEWERS} pages are open already; close one of them"})
            await connection.close(_TRY_LATER)
            return
        await Viewer(connection, home.feeds, home.hub, home.measured).serve()

    return app


def add_page(app: FastAPI, page: Page) -> None:
    """The routes of the page itself: its views, which are one file, and what that file needs."""

    def sent(file: StaticFile) -> Response:
        # Small files of the page cache: read here; FileResponse would start threads that outlive the loop.
        return Response(file.path.read_bytes(), media_type=file.media_type, headers=_FRESH)

    async def root() -> Response:
        return RedirectResponse("/live", 307)

    async def index() -> Response:
        if page.index is None:
            return refusal(503, "no_page", "the page's files are missing from this installation")
        return sent(page.index)

    async def static(name: str) -> Response:
        found = page.files.get(name)
        if found is None:
            return refusal(404, "not_found", "there is no such file")
        return sent(found)

    def serve(path: str, route: Route) -> None:
        app.add_api_route(path, route, methods=["GET"], include_in_schema=False, response_model=None)

    serve("/", root)
    serve("/static/{name:path}", static)
    for view in VIEWS:
        serve(f"/{view}", index)
