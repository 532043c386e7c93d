"""An id that was seen at several places: which of them is the object's own marker. Pure; never a guess."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from common.errors import PoseError
from common.geometry import Box, CameraModel
from services.label.pose import Prior, solve_box
from services.label.visible_objects import SeenMarker, VisibleObject


def settle_copies(
    visible: VisibleObject, camera: CameraModel, ambiguous_px: float, prior: Prior | None
) -> tuple[list[SeenMarker], list[SeenMarker]]:
    """The markers to use, and the copies that stay doubtful (all of an undecided id, else the false ones).

    The object's other markers decide: exactly one copy fits together with them. Else its last pose: one copy
    lies where the marker must be, all others lie elsewhere.
    """
    used = list(visible.markers)
    doubtful: list[SeenMarker] = []
    for group in visible.copies:
        true = _fitting(visible.box, visible.markers, group, camera, ambiguous_px)
        if true is None and prior is not None:
            true = _expected(visible.box, group, camera, prior)
        used += [] if true is None else [true]
        doubtful += [copy for copy in group if copy is not true]
    return used, doubtful


def _fitting(
    box: Box, others: Sequence[SeenMarker], group: Sequence[SeenMarker], camera: CameraModel, ambiguous_px: float
) -> SeenMarker | None:
    if not others:
        return None
    fitting = [copy for copy in group if _fits(box, others, copy, camera, ambiguous_px)]
    return fitting[0] if len(fitting) == 1 else None


def _fits(box: Box, others: Sequence[SeenMarker], copy: SeenMarker, camera: CameraModel, ambiguous_px: float) -> bool:
    try:
        return not solve_box(box, [*others, copy], camera, ambiguous_px).contradicting
    except PoseError:
        return False


def _expected(box: Box, group: Sequence[SeenMarker], camera: CameraModel, prior: Prior) -> SeenMarker | None:
    side, marker = group[0].side, group[0].marker
    where, front = camera.project(prior.pose.apply(box.marker_corners(side, marker)))
    if not front.all():
        return None
    off = [float(np.linalg.norm(copy.corners - where, axis=1).mean()) / copy.side_px for copy in group]
    near, next_ = sorted(off)[:2]
    return group[off.index(near)] if near < 0.5 and next_ > 1.0 else None
