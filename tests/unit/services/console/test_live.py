"""The present view against what is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from common.config import Rig, load_rig
from common.labels import ObjectLabel
from common.messages import FrameRef, Labels
from services.console.catalog import Catalog
from services.console.live import LiveView
from tests.support.samples import object_label


class Listed(Catalog):
    """A catalog with these samples, which asks nobody."""

    def __init__(self, *angles: tuple[float, float, float]) -> None:
        super().__init__(self.nobody)
        for number, (azimuth, elevation, distance) in enumerate(angles):
            seen = {"name": "box-0", "azimuth_deg": azimuth, "elevation_deg": elevation, "distance_mm": distance}
            self.stored[str(number)] = {"objects": [seen]}

    async def nobody(self, fields: dict[str, Any], limit_s: float) -> dict[str, Any]:
        raise AssertionError(f"asked {fields} within {limit_s}")


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "rig.yaml").write_text("cameras:\n  cam0: {driver: synthetic}\n  cam1: {driver: synthetic}\n")
    return load_rig(tmp_path / "rig.yaml")


def labels(camera: str, *objects: ObjectLabel) -> Labels:
    ref = FrameRef(camera=camera, boot="a", ring="r", frame=1, count=1, captured_mono_ns=1, captured_wall_ns=0)
    return Labels(ref=ref, objects=objects)


def at(distance_mm: float) -> ObjectLabel:
    return object_label().model_copy(update={"distance_mm": distance_mm})


def test_the_nearest_cameras_view_is_told_with_what_is_measured(rig: Rig) -> None:
    view = LiveView(Listed())
    newest = [labels("cam0", at(1200.0)), labels("cam1", at(900.0)), labels("cam0")]
    found = view.data(newest, {"cam1/box-0": 42.34, "cam0/box-0": 1.0}, rig)
    assert found.keys() == {"box-0"}
    told = found["box-0"]
    assert (told["camera"], told["distance_mm"], told["sharpness"], told["fit_px"]) == ("cam1", 900.0, 42.3, 0.3)
    assert (told["new_by_deg"], told["new_by_mm"]) == (None, None), "nothing recorded: new whatever the limits"
    assert view.data([], {}, rig) == {}


def test_new_is_measured_to_what_is_recorded_and_follows_the_catalog(rig: Rig) -> None:
    seen = LiveView(Listed()).data([labels("cam0", at(1000.0))], {}, rig)["box-0"]
    here = (seen["azimuth"], seen["elevation"])
    catalog = Listed((*here, 1000.0), (*here, 1500.0))
    view = LiveView(catalog)
    told = view.data([labels("cam0", at(1030.0))], {}, rig)["box-0"]
    assert told["new_by_deg"] == pytest.approx(0.0, abs=0.1)
    assert told["new_by_mm"] == pytest.approx(30.0)
    catalog.stored.clear()
    catalog.version += 1
    assert view.data([labels("cam0", at(1030.0))], {}, rig)["box-0"]["new_by_mm"] is None
