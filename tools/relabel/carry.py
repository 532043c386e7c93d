"""What other frames said of one, when objects or cameras are described otherwise now. Pure.

A pose of another frame was the answer to what was seen there, under the rig of that time. What was seen doesn't
change: its markers are put into the picture by the old description, and the new one is fitted to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from common.errors import PoseError
from common.geometry import Box, CameraModel, Pose
from common.labels import CameraLabel
from common.messages import DetectedMarker
from services.label.labelling import Around
from services.label.pose import CERTAIN, Prior, solve_box
from services.label.sightings import Expected, Sighting
from services.label.visibility import faces_camera
from services.label.visible_objects import SeenMarker

_AMBIGUOUS_PX = 6.0
_OPTICS = ("width", "height", "matrix", "distortion", "model")


@dataclass(frozen=True)
class Described:
    """Objects by name, and a camera."""

    boxes: Mapping[str, Box]
    camera: CameraLabel


def carried(around: Around, before: Described, now: Described) -> Around:
    """The same for the new description; what is described alike stays as it is, bit by bit.

    An object whose earlier poses can't be told any more (none of the markers it showed is still its own) has none.
    """
    alike = all(getattr(before.camera, key) == getattr(now.camera, key) for key in _OPTICS)
    changed = {
        name for name, box in now.boxes.items() if name in before.boxes and not (alike and before.boxes[name] == box)
    }
    gone = set(before.boxes) - set(now.boxes)
    if not changed and not gone:
        return around
    old_camera, new_camera = CameraModel.from_label(before.camera), CameraModel.from_label(now.camera)

    def moved(name: str, pose: Pose) -> Pose | None:
        if name not in changed:
            return None if name in gone else pose
        return _moved(pose, before.boxes[name], now.boxes[name], old_camera, new_camera)

    def sighting(name: str, seen: Sighting | None) -> Sighting | None:
        pose = None if seen is None else moved(name, seen.pose)
        return None if seen is None or pose is None else replace(seen, pose=pose)

    previous = {name: (prior, moved(name, prior.pose)) for name, prior in around.previous.items()}
    expected = []
    for item in around.expected:
        latest = sighting(item.name, item.before)
        if latest is not None:
            expected.append(
                Expected(
                    item.name,
                    item.time_ns,
                    latest,
                    sighting(item.name, item.earlier),
                    sighting(item.name, item.after),
                )
            )
    return Around(
        previous={name: replace(prior, pose=pose) for name, (prior, pose) in previous.items() if pose is not None},
        expected=tuple(expected),
        steady=around.steady,
    )


def _moved(pose: Pose, old: Box, new: Box, old_camera: CameraModel, new_camera: CameraModel) -> Pose | None:
    """The new box's pose whose markers lie in the picture where the old box's did."""
    places = {marker.id: (side, marker) for side, marker in new.markers()}
    seen = []
    for side, marker in old.markers():
        place = places.get(marker.id)
        if place is None or not faces_camera(pose, old, side, marker):
            continue
        pixels, front = old_camera.project(pose.apply(old.marker_corners(side, marker)))
        if front.all() and np.isfinite(pixels).all():
            top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in pixels)
            corners = (top_left, top_right, bottom_right, bottom_left)
            seen.append(SeenMarker(*place, DetectedMarker(id=marker.id, corners=corners, kind="photometric")))
    if not seen:
        return None
    try:
        return solve_box(new, seen, new_camera, _AMBIGUOUS_PX, Prior(pose, CERTAIN, confirmed=True)).pose
    except PoseError:
        return None
