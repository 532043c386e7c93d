"""What the page reads beside the command socket: events, the rig, coverage, samples' pictures, health, metrics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Protocol, get_args

from fastapi import APIRouter, Query, Response
from starlette.responses import JSONResponse

from common.config import Rig
from common.config.quality import read_quality
from common.errors import DatasetError
from common.words import WORDS
from services.console.catalog import Catalog
from services.console.coverage import Views, answer, faces_with_markers, wanted_cells
from services.console.hub import StateHub
from services.console.line import Plain
from services.console.pictures import Pictures, What
from services.console.rest import answered, refusal

_KEEP = {"cache-control": "private, max-age=3600"}
"""A sample's pictures never change; a label may, by `tagmill relabel`."""


class Source(Protocol):
    """What the routes need of the console."""

    hub: StateHub
    catalog: Catalog
    pictures: Pictures

    @property
    def rig(self) -> Rig:
        """The rig as the stack has it."""

    async def status(self) -> Plain:
        """What the command `status` answers."""

    def now_of(self, name: str) -> tuple[float, float] | None:
        """From where an object is seen now: azimuth, elevation (deg)."""

    def metrics(self) -> bytes:
        """In Prometheus's text format."""

    @property
    def healthy(self) -> bool:
        """Whether control is heard."""


def router(source: Source) -> APIRouter:
    """The routes."""
    made = APIRouter()
    for part in (_state(source), _samples(source), _health(source)):
        made.include_router(part)
    return made


def _state(source: Source) -> APIRouter:
    made = APIRouter()

    @made.get("/api/status", tags=["state"], response_model=None)
    async def status() -> Response:
        """As the command `status`."""
        return answered(await source.status())

    @made.get("/api/events", tags=["state"], response_model=None)
    async def events(after: Annotated[int, Query(ge=0)] = 0) -> Response:
        """What happened after event number `after`; the newest 500 are kept."""
        kept = [event.fields for event in source.hub.events_after(after)]
        return JSONResponse({"events": kept, "last": source.hub.last_event})

    @made.get("/api/rig", tags=["state"], response_model=None)
    async def rig() -> Response:
        """Objects with their markers, cameras with their calibration."""
        return JSONResponse(rig_answer(source.rig))

    return made


def _samples(source: Source) -> APIRouter:
    made = APIRouter()

    @made.get("/api/words", tags=["state"], response_model=None)
    async def words() -> Response:
        """Every code in plain words: a title, and what to do."""
        return JSONResponse({code: found._asdict() for code, found in WORDS.items()})

    @made.get("/api/coverage", tags=["samples"], response_model=None)
    async def coverage(name: Annotated[str, Query(alias="object", max_length=200)]) -> Response:
        """From where an object was recorded in the open session, and which view is the next that is missing."""
        box = next((box for box in source.rig.boxes if box.name == name), None)
        if box is None:
            known = ", ".join(box.name for box in source.rig.boxes) or "none"
            return refusal(404, "no_object", f"the rig has no object of that name; known are {known}")
        refused = await source.catalog.refresh()
        if refused is not None:
            return answered(refused)
        views = Views.of(source.catalog.stored.values(), name)
        return JSONResponse(answer(name, views, wanted_cells(faces_with_markers(box.sides)), source.now_of(name)))

    @made.get("/api/samples/{name}/{what}", tags=["samples"], response_model=None)
    async def sample(name: str, what: str, binned: Annotated[bool, Query(alias="bin")] = False) -> Response:
        """A file of a sample of the open session: rgb, original (as stored), depth, thumb (JPEG), label (JSON)."""
        if what not in get_args(What):
            return refusal(404, "not_found", f"a sample has {', '.join(get_args(What))}")
        item, refused = await _find(source.catalog, name, binned=binned)
        if item is None:
            return refused
        status = await source.status()
        if not status.get("ok"):
            return answered(status)
        session = Path(status["dataset"]) / str(source.catalog.session)
        try:
            found = await source.pictures.read(session, item, what, binned=binned)  # type: ignore[arg-type]
        except DatasetError as error:
            return refusal(404, error.code, error.message)
        return Response(found.data, media_type=found.media_type, headers=_KEEP if what != "label" else {})

    return made


def _health(source: Source) -> APIRouter:
    made = APIRouter()

    @made.get("/healthz", tags=["health"], response_model=None)
    async def healthz() -> Response:
        """200 while the stack's control is heard, else 503."""
        return JSONResponse({"ok": source.healthy}, 200 if source.healthy else 503)

    @made.get("/metrics", tags=["health"], response_model=None)
    async def metrics() -> Response:
        """For Prometheus."""
        return Response(source.metrics(), media_type="text/plain; version=0.0.4; charset=utf-8")

    return made


async def _find(catalog: Catalog, name: str, *, binned: bool) -> tuple[Plain | None, Response]:
    """A sample of the list, which is brought up to date first where it isn't there."""
    item, refused = await catalog.look_up(name, binned=binned)
    if item is None and refused is not None:
        return None, answered(refused)
    where = "in the bin" if binned else "in the open session"
    return item, refusal(404, "no_sample", f"there is no such sample {where}")


def rig_answer(rig: Rig) -> Plain:
    """What the page shows of a rig."""
    return {
        "objects": [_object(box) for box in rig.boxes],
        "cameras": [_camera(rig, name) for name in rig.config.cameras],
        "markers": {"family": rig.config.markers.family},
        "auto": rig.config.record.auto.model_dump(mode="json"),
    }


def _object(box: Any) -> Plain:
    width, height, depth = box.size_mm
    return {
        "name": box.name,
        "type": box.type,
        "size_mm": {"width": width, "height": height, "depth": depth},
        "sides": [
            {
                "class": side.class_name,
                "face": side.face,
                "markers": [{"id": marker.id, "size_mm": marker.size_mm} for marker in side.markers],
            }
            for side in box.sides
        ],
    }


def _camera(rig: Rig, name: str) -> Plain:
    camera = rig.config.cameras[name]
    label = rig.calibration(name)
    calibration = None
    if label is not None:
        assert camera.calibration is not None
        quality = read_quality(rig.resolve(camera.calibration))
        calibration = {
            "file": str(camera.calibration),
            "width": label.width,
            "height": label.height,
            "verdict": None if quality is None else quality.verdict,
            "reasons": [] if quality is None else list(quality.reasons),
            "focal_percent": None if quality is None else quality.focal_percent,
        }
    return {"name": name, "driver": camera.driver, "calibrated": label is not None, "calibration": calibration}
