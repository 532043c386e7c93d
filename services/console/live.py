"""The present view of each object against what is recorded: how new it is, how sharp, how well it fits."""

from __future__ import annotations

from typing import Any

from common.config import Rig
from common.geometry import view_direction
from common.labels import ObjectLabel
from common.messages import Labels
from services.console.catalog import Catalog
from services.console.coverage import Views, cell_of, direction


class LiveView:
    """Makes the topic ``coverage``; the recorded views are looked up anew when the catalog has changed."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._version = -1
        self._views: dict[str, Views] = {}

    def data(self, newest: list[Labels], sharpness: dict[str, float], rig: Rig) -> dict[str, Any]:
        """For each object that is in view, from the camera that is nearest to it."""
        if self._version != self._catalog.version:
            self._version = self._catalog.version
            self._views.clear()
        nearest: dict[str, tuple[ObjectLabel, str]] = {}
        for labels in newest:
            for item in labels.objects:
                known = nearest.get(item.name)
                if known is None or item.distance_mm < known[0].distance_mm:
                    nearest[item.name] = (item, labels.ref.camera)
        return {
            name: self._of(item, camera, sharpness.get(f"{camera}/{name}"), rig)
            for name, (item, camera) in sorted(nearest.items())
        }

    def _of(self, item: ObjectLabel, camera: str, sharpness: float | None, rig: Rig) -> dict[str, Any]:
        limits = rig.config.record.auto
        if item.name not in self._views:
            self._views[item.name] = Views.of(self._catalog.stored.values(), item.name)
        azimuth, elevation = view_direction(item.pose.matrix)
        new_deg, new_mm = self._views[item.name].nearest(
            direction(azimuth, elevation), item.distance_mm, limits.new_deg, limits.new_mm
        )
        return {
            "camera": camera,
            "azimuth": round(azimuth, 1),
            "elevation": round(elevation, 1),
            "distance_mm": round(item.distance_mm, 1),
            "cell": cell_of(azimuth, elevation),
            "new_by_deg": None if new_deg is None else round(new_deg, 1),
            "new_by_mm": None if new_mm is None else round(new_mm, 1),
            "sharpness": None if sharpness is None else round(sharpness, 1),
            "fit_px": round(item.quality.reprojection_error_px, 2),
        }
