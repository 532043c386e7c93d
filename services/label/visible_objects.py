"""From detected markers to objects: which configured marker was seen where. Pure.

Unknown ids are kept apart, several sides of one object are joined, several objects of one type stay apart
(they carry different ids), and an id that was seen at several places is not guessed here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from common.geometry import Box, BoxSide, MarkerOnSide
from common.labels import LeftOut
from common.messages import DetectedMarker

Array = NDArray[np.float64]

CORNER_NOISE_PX = {"photometric": 0.05, "edges": 0.1, "apriltag": 0.1, "subpix": 0.3, "contour": 0.7}
"""Standard deviation of a corner (px, one axis) by how it was found, as measured on rendered
markers; a fit that turns out worse than this counts as noisier (``services.label.pose``)."""
_NEXT = np.array([1, 2, 3, 0])
SAME_PLACE = 0.25
"""Two detections of one id whose centres are nearer than this share of their side are one marker seen twice."""


@dataclass(frozen=True, eq=False)
class SeenMarker:
    """A configured marker and its detection; ``covariance`` (8, 8) px^2 of its corners where they were refined."""

    side: BoxSide
    marker: MarkerOnSide
    seen: DetectedMarker
    covariance: Array | None = None

    @property
    def corners(self) -> Array:
        """Detected corners (4, 2) px, TL TR BR BL in the marker's own frame."""
        return np.array(self.seen.corners, dtype=np.float64)

    @property
    def noise_px(self) -> float:
        """Standard deviation of a corner coordinate (px)."""
        if self.covariance is not None:
            return float(np.sqrt(np.trace(self.covariance) / 8))
        return CORNER_NOISE_PX.get(self.seen.kind, CORNER_NOISE_PX["contour"])

    @property
    def side_px(self) -> float:
        """Mean length (px) of the marker's four sides in the picture."""
        return side_length(self.corners)


@dataclass(frozen=True, eq=False)
class VisibleObject:
    """An object of which at least one marker was seen; ``copies`` are ids that were seen at several places."""

    box: Box
    markers: tuple[SeenMarker, ...]
    copies: tuple[tuple[SeenMarker, ...], ...] = ()


@dataclass(frozen=True, eq=False)
class Sorted:
    """All detections of a frame, sorted; objects in rig order."""

    objects: tuple[VisibleObject, ...]
    unknown: tuple[DetectedMarker, ...] = ()
    unseen: tuple[Box, ...] = field(default=())


def sort_markers(detected: Iterable[DetectedMarker], boxes: Sequence[Box]) -> Sorted:
    """Give each detected marker to the object that carries its id."""
    places = _by_id(detected)
    known = {marker.id for box in boxes for _, marker in box.markers()}
    objects = []
    unseen = []
    for box in boxes:
        found = [
            tuple(SeenMarker(side, marker, seen) for seen in places[marker.id])
            for side, marker in box.markers()
            if marker.id in places
        ]
        if not found:
            unseen.append(box)
            continue
        single = tuple(group[0] for group in found if len(group) == 1)
        objects.append(VisibleObject(box, single, tuple(group for group in found if len(group) > 1)))
    unknown = tuple(seen for id_, group in places.items() if id_ not in known for seen in group)
    return Sorted(tuple(objects), unknown, tuple(unseen))


def doubted(marker: SeenMarker, doubt_px: Sequence[float]) -> SeenMarker:
    """The marker with corners that may be off by ``doubt_px`` (4,), one sigma, beside what their kind promises.

    Where the picture doesn't bear out what the detector says: a covered corner, heavy blur, a shadow.
    """
    variance = np.repeat(np.hypot(marker.noise_px, np.asarray(doubt_px) / np.sqrt(2)) ** 2, 2)
    return replace(marker, covariance=np.diag(variance))


def left_out(marker: SeenMarker, reason: str, box: Box) -> LeftOut:
    """The entry of a detected, configured marker that gave no side."""
    return LeftOut(marker=marker.marker.id, reason=reason, object=box.name, corners=marker.seen.corners)


def not_detected(marker: MarkerOnSide, box: Box) -> LeftOut:
    """The entry of a configured marker that was not seen."""
    return LeftOut(marker=marker.id, reason="not_detected", object=box.name)


def side_length(corners: Array) -> float:
    """Mean side length (px) of a quadrilateral (4, 2)."""
    sides = corners - corners[_NEXT]
    return float(np.hypot(sides[:, 0], sides[:, 1]).mean())


def _by_id(detected: Iterable[DetectedMarker]) -> dict[int, list[DetectedMarker]]:
    places: dict[int, list[DetectedMarker]] = {}
    for seen in detected:
        group = places.setdefault(seen.id, [])
        if not any(_same_place(seen, other) for other in group):
            group.append(seen)
    return places


def _same_place(first: DetectedMarker, second: DetectedMarker) -> bool:
    """A detector that reports one marker twice (inner and outer contour) means one marker, not two."""
    one, two = np.array(first.corners), np.array(second.corners)
    apart = float(np.linalg.norm(one.mean(axis=0) - two.mean(axis=0)))
    return apart < SAME_PLACE * min(side_length(one), side_length(two))
