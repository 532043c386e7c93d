"""`mode: auto`: which views are worth a sample. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.geometry import Pose
from common.labels import ObjectLabel
from common.ledgers import AutoLimits
from common.messages import AutoNow, AutoSeen

MEASURE_EVERY_NS = 200_000_000
"""Sharpness is measured of frames that are worth a sample otherwise, and so often of others, to be shown."""

Measure = Callable[[], Mapping[str, float]]
"""Gives each object's sharpness; looks at the pixels, so it is called for few frames only."""


@dataclass
class Auto:
    """One recording's limits and views: direction from each object to the camera, distance.

    A view counts from when its sample is begun; it is taken back if the sample is refused on its way.
    """

    limits: AutoLimits
    taken: dict[str, list[tuple[str, NDArray[np.float64], float]]] = field(default_factory=dict)
    now: AutoNow | None = None
    _sharpness: dict[str, float] = field(default_factory=dict)
    _measured_ns: int | None = None

    def judge(self, frame: int, objects: Sequence[ObjectLabel], measure: Measure, now_ns: int) -> str | None:
        """None if one of the objects is seen from a new view, and all fit well and are sharp, else why not:
        ``bad_fit``, ``not_new`` or ``blurred``.

        New = no view taken so far is nearer than ``new_deg`` in direction and ``new_mm`` in distance at once.
        """
        limits = self.limits
        views = {item.name: self._nearest(item) for item in objects}
        reason: str | None = None
        if any(item.quality.reprojection_error_px > limits.fit_px or item.quality.ambiguous for item in objects):
            reason = "bad_fit"
        elif not any(new_deg is None or new_deg >= limits.new_deg for new_deg, _ in views.values()):
            reason = "not_new"
        if limits.sharpness > 0 and (reason is None or self._due(now_ns)):
            self._sharpness, self._measured_ns = dict(measure()), now_ns
        if reason is None and any(self._sharpness.get(item.name, 100.0) < limits.sharpness for item in objects):
            reason = "blurred"
        self.now = AutoNow(
            frame=frame, reason=reason, objects=tuple(self._seen(item, *views[item.name]) for item in objects)
        )
        return reason

    def nothing(self, frame: int, reason: str | None) -> str | None:
        """A frame without a view to judge: `reason` as it is, None where others will say what is wrong."""
        self.now = AutoNow(frame=frame, reason=reason or "no_object", objects=())
        return reason

    def take(self, sample: str, objects: Sequence[ObjectLabel]) -> None:
        """Remember the views of a sample."""
        for item in objects:
            self.taken.setdefault(item.name, []).append((sample, *_view(item)))

    def forget(self, sample: str) -> None:
        """The sample was refused: its views are still wanted."""
        for name, views in self.taken.items():
            self.taken[name] = [view for view in views if view[0] != sample]

    def _due(self, now_ns: int) -> bool:
        return self._measured_ns is None or now_ns - self._measured_ns >= MEASURE_EVERY_NS

    def _nearest(self, item: ObjectLabel) -> tuple[float | None, float | None]:
        """Degrees to the nearest view within ``new_mm``, mm to the nearest one within ``new_deg``; None: none is."""
        direction, distance = _view(item)
        degrees: list[float] = []
        millimetres: list[float] = []
        for _, seen, at in self.taken.get(item.name, []):
            apart = float(np.degrees(np.arccos(np.clip(direction @ seen, -1.0, 1.0))))
            away = abs(distance - at)
            if away < self.limits.new_mm:
                degrees.append(apart)
            if apart < self.limits.new_deg:
                millimetres.append(away)
        return min(degrees, default=None), min(millimetres, default=None)

    def _seen(self, item: ObjectLabel, new_deg: float | None, new_mm: float | None) -> AutoSeen:
        return AutoSeen(
            object=item.name,
            new_deg=new_deg,
            new_mm=new_mm,
            sharpness=self._sharpness.get(item.name),
            fit_px=item.quality.reprojection_error_px,
        )


def _view(item: ObjectLabel) -> tuple[NDArray[np.float64], float]:
    camera = Pose.from_label(item.pose).inverse().translation
    distance = float(np.linalg.norm(camera))
    return camera / max(distance, 1e-9), distance
