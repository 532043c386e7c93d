"""Where each object was seen lately, and where it therefore is at a moment at which it was not.

The label loop keeps what it saw; a frame that is kept takes along, by value, what was seen just before and just
after it (``Expected``).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import Box, CameraModel, Pose
from services.label.occlusion import look
from services.label.pose import BoxPose
from services.label.uncertainty import Spread, spread_of
from services.label.windows import project_box

Array = NDArray[np.float64]

SEEN_NS = 1_000_000_000
"""An object seen within this time is expected to be there still."""
GAP_NS = 500_000_000
"""Poses are interpolated between frames that are no further apart."""
LARGEST_TURN = np.radians(60.0)
"""... and that show the object turned by no more."""
_EXTRAPOLATED_NS = 300_000_000
"""A motion is carried on for so long; then the object counts as standing still."""
_VELOCITY_NS = 50_000_000
"""Poses nearer together give no velocity: their noise would be most of it."""
UNSTEADY_PER_S = 0.4
"""By how much of the way between two poses that lie a second apart its middle may lie beside it, one sigma."""
SWAY_MM, SWAY_RAD = 50.0, 0.1
"""... and by how much however short the way: things turn back. Both per second squared of time between the poses."""
_LEAST_VISIBLE = 0.02
"""An object of whose facing sides less than this share can be seen isn't expected to be found."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """A pose at a time; ``covariance`` (6, 6) of a rotation (rad) and a shift (mm) in the camera frame."""

    time_ns: int
    pose: Pose
    covariance: Array


@dataclass(frozen=True, eq=False)
class Expected:
    """An object that was seen near ``time_ns``: at the latest ``before`` it, ``earlier`` still, and just ``after``."""

    name: str
    time_ns: int
    before: Sighting
    earlier: Sighting | None = None
    after: Sighting | None = None

    @property
    def seen_ms_ago(self) -> float:
        """How long ago it was seen."""
        return (self.time_ns - self.before.time_ns) / 1e6

    def between(self) -> tuple[Pose, Spread] | None:
        """The interpolated pose and how far it may be off; None unless it is known just before and just after."""
        if self.after is None:
            return None
        before, after = self.before, self.after
        gap = after.time_ns - before.time_ns
        if not 0 < gap <= GAP_NS or before.pose.angle_to(after.pose) > LARGEST_TURN:
            return None
        share = (self.time_ns - before.time_ns) / gap
        turn, shift = _way(before.pose, after.pose)
        covariance = (1 - share) ** 2 * before.covariance + share**2 * after.covariance
        middle, gap_s = 4 * share * (1 - share), gap / 1e9
        for part, way, sway in ((slice(0, 3), turn, SWAY_RAD), (slice(3, 6), shift, SWAY_MM)):
            beside = (UNSTEADY_PER_S * gap_s) ** 2 * float(way @ way) / 3 + (sway * gap_s**2) ** 2
            covariance[part, part] += np.eye(3) * (beside * middle**2)
        return _moved(before.pose, turn, shift, share), Spread(covariance)

    def guess(self) -> Pose:
        """Where the object is most likely: interpolated, else carried on with its last motion."""
        between = self.between()
        if between is not None:
            return between[0]
        if self.earlier is None:
            return self.before.pose
        turn, shift = _way(self.earlier.pose, self.before.pose)
        if float(np.linalg.norm(turn)) > LARGEST_TURN:
            return self.before.pose
        ahead = min(self.time_ns - self.before.time_ns, _EXTRAPOLATED_NS)
        return _moved(self.before.pose, turn, shift, ahead / (self.before.time_ns - self.earlier.time_ns))


class Sightings:
    """The poses of the last two seconds, by camera and object."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], deque[Sighting]] = {}
        self._newest: dict[str, int] = {}

    def saw(self, camera: str, name: str, time_ns: int, found: BoxPose) -> None:
        """Keep a pose; a frame that was kept already stays as it was."""
        known = self._seen.setdefault((camera, name), deque())
        if known and time_ns <= known[-1].time_ns:
            return
        known.append(Sighting(time_ns, found.pose, spread_of(found, tilts=False).covariance))
        while time_ns - known[0].time_ns > 2 * SEEN_NS:
            known.popleft()

    def looked(self, camera: str, time_ns: int) -> bool:
        """Note a frame of a camera; False if time ran backwards (another video, say): then all before is forgotten."""
        back = time_ns < self._newest.get(camera, time_ns)
        if back:
            self.forget(camera)
        self._newest[camera] = time_ns
        return not back

    def expected(self, camera: str, name: str, time_ns: int) -> Expected | None:
        """What is known of an object around a moment; None if it wasn't seen within the second before."""
        known = self._seen.get((camera, name), ())
        past = [item for item in known if item.time_ns < time_ns]
        if not past or time_ns - past[-1].time_ns > SEEN_NS:
            return None
        before = past[-1]
        earlier = next((item for item in reversed(past) if before.time_ns - item.time_ns >= _VELOCITY_NS), None)
        if earlier is not None and before.time_ns - earlier.time_ns > GAP_NS:
            earlier = None
        after = next((item for item in known if item.time_ns > time_ns), None)
        return Expected(name, time_ns, before, earlier, after)

    def forget(self, camera: str) -> None:
        """Drop a camera's sightings."""
        self._seen = {key: value for key, value in self._seen.items() if key[0] != camera}
        self._newest.pop(camera, None)


def in_view(box: Box, pose: Pose, camera: CameraModel, others: list[tuple[Box, Pose]]) -> bool:
    """Whether a box at this pose is in the picture, and not hidden behind the others."""
    try:
        if project_box(box, pose, camera).window is None:
            return False
    except PoseError:
        return False
    return any(face.visible_share > _LEAST_VISIBLE for face in look(box, pose, camera, others).faces)


def _way(first: Pose, second: Pose) -> tuple[Array, Array]:
    """Rotation vector (rad, camera frame, about the object's origin) and shift (mm) from one pose to another."""
    turn, _ = cv2.Rodrigues(second.rotation @ first.rotation.T)
    return np.asarray(turn, dtype=np.float64).reshape(3), second.translation - first.translation


def _moved(pose: Pose, turn: Array, shift: Array, share: float) -> Pose:
    """A pose moved by a share (may be over 1) of a way."""
    rotation, _ = cv2.Rodrigues(turn * share)
    return Pose(np.asarray(rotation, dtype=np.float64) @ pose.rotation, pose.translation + shift * share)
