"""`mode: auto`: which views are worth a sample. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from common.geometry import Pose
from common.labels import ObjectLabel

NEW_ANGLE_DEG = 12.0
NEW_DISTANCE_MM = 80.0
FIT_PX = 1.5


@dataclass
class Views:
    """The views of each object that a recording has taken: direction from the object to the camera, distance.

    A view counts from when its sample is begun; it is taken back if the sample is refused on its way.
    """

    taken: dict[str, list[tuple[str, NDArray[np.float64], float]]] = field(default_factory=dict)

    def judge(self, objects: Sequence[ObjectLabel]) -> str | None:
        """None if one of the objects is seen from a new view and all fit well, else ``bad_fit`` or ``not_new``.

        New = no view taken so far is nearer than 12 degrees in direction and 80 mm in distance at once.
        """
        if any(item.quality.reprojection_error_px > FIT_PX or item.quality.ambiguous for item in objects):
            return "bad_fit"
        return None if any(self._is_new(item) for item in objects) else "not_new"

    def take(self, sample: str, objects: Sequence[ObjectLabel]) -> None:
        """Remember the views of a sample."""
        for item in objects:
            self.taken.setdefault(item.name, []).append((sample, *_view(item)))

    def forget(self, sample: str) -> None:
        """The sample was refused: its views are still wanted."""
        for name, views in self.taken.items():
            self.taken[name] = [view for view in views if view[0] != sample]

    def _is_new(self, item: ObjectLabel) -> bool:
        direction, distance = _view(item)
        limit = np.cos(np.radians(NEW_ANGLE_DEG))
        return not any(
            float(direction @ seen) > limit and abs(distance - at) < NEW_DISTANCE_MM
            for _, seen, at in self.taken.get(item.name, [])
        )


def _view(item: ObjectLabel) -> tuple[NDArray[np.float64], float]:
    camera = Pose.from_label(item.pose).inverse().translation
    distance = float(np.linalg.norm(camera))
    return camera / max(distance, 1e-9), distance
