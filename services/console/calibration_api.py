"""The routes of the guided calibration."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, Protocol, get_args

from fastapi import APIRouter, Request, Response
from pydantic import ValidationError
from starlette.responses import JSONResponse

from common.config import Rig
from common.errors import ConfigError, RefusedError, TagmillError
from common.messages import CameraState
from services.console.calibrating import Start, arguments, boards_beside, kept, kept_places
from services.console.calibrator import Calibrator, Order
from services.console.line import Plain
from services.console.rest import read_body, refusal

_BOARD_PROBLEMS = 5


class Home(Protocol):
    """What the routes need of the console."""

    calibrator: Calibrator

    @property
    def rig(self) -> Rig:
        """The rig as the stack has it."""

    def camera_state(self, name: str) -> CameraState | None:
        """What a camera said of itself last."""


def router(home: Home) -> APIRouter:
    """Begin, take, drop, finish, stop; what there is to begin with; the report."""
    made = APIRouter(prefix="/api/calibration", tags=["calibration"])
    _reading(made, home)
    _doing(made, home)
    return made


def _reading(made: APIRouter, home: Home) -> None:
    @made.get("", response_model=None)
    async def calibration() -> Response:
        """What runs, and what one may begin with: board descriptions beside the rig file, kept views by camera."""
        boards = [
            {"file": name, "board": board.model_dump(mode="json", exclude_none=True)}
            for name, board in boards_beside(home.rig).items()
        ]
        views = {name: kept(kept_places(home.rig, name, home.camera_state(name))) for name in home.rig.config.cameras}
        return JSONResponse({"state": home.calibrator.data(), "boards": boards, "kept": views})

    @made.get("/report", response_model=None)
    async def report() -> Response:
        """The report of the calibration that ended last, as a file to keep: it has styles of its own."""
        path = home.calibrator.report
        try:
            data = None if path is None else path.read_bytes()
        except OSError:
            data = None
        if path is None or data is None:
            return refusal(404, "no_report", "no calibration has ended since the console's start")
        headers = {"content-disposition": f'attachment; filename="{path.name}"'}
        return Response(data, media_type="text/html; charset=utf-8", headers=headers)


def _doing(made: APIRouter, home: Home) -> None:
    @made.post("/start", response_model=None, openapi_extra=_body(Start.model_json_schema()))
    async def start(request: Request) -> Response:
        """Begin with a camera and a board, or go on with the views that are kept."""
        try:
            wanted = Start.model_validate(await read_body(request))
            home.rig.camera(wanted.camera)
            found = kept_places(home.rig, wanted.camera, home.camera_state(wanted.camera))
            await home.calibrator.start(wanted.camera, arguments(wanted, home.rig, found))
        except ValidationError as error:
            problems = "; ".join(_words(item["loc"], item["msg"]) for item in error.errors(include_url=False))
            return refusal(422, "bad_request", problems)
        except (ValueError, OverflowError, TagmillError) as error:
            return _refused(error)
        return JSONResponse({"ok": True})

    for order in get_args(Order):
        made.add_api_route(f"/{order}", _ordering(home, order), methods=["POST"], response_model=None, name=order)

    @made.post("/stop", response_model=None)
    async def stop() -> Response:
        """End it; the views are kept."""
        home.calibrator.stop()
        return JSONResponse({"ok": True})

    @made.post("/look", response_model=None)
    async def look() -> Response:
        """A page shows it: renew this at least once a minute, or the calibration ends."""
        home.calibrator.look()
        return JSONResponse({"ok": True})


def _ordering(home: Home, order: Order) -> Callable[[], Coroutine[Any, Any, Response]]:
    async def ordered() -> Response:
        try:
            await home.calibrator.order(order)
        except RefusedError as error:
            return _refused(error)
        return JSONResponse({"ok": True})

    ordered.__doc__ = {
        "take": "Take a view of the next frame, whether or not the board is still.",
        "drop": "Take the newest view back.",
        "finish": "Calibrate with the views that there are.",
    }[order]
    return ordered


def _refused(error: Exception) -> Response:
    if isinstance(error, ConfigError):
        return refusal(422, error.code, "; ".join(error.problems[:_BOARD_PROBLEMS]))
    if isinstance(error, TagmillError):
        return refusal(422 if error.code == "bad_request" else 409, error.code, error.message)
    return refusal(413 if isinstance(error, OverflowError) else 422, "bad_request", str(error))


def _words(place: tuple[int | str, ...], message: str) -> str:
    where = ".".join(str(part) for part in place)
    said = message.removeprefix("Value error, ")
    return f"{where}: {said}" if where else said


def _body(schema: Plain) -> Plain:
    return {"requestBody": {"content": {"application/json": {"schema": schema}}}}
