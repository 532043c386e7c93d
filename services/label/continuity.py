"""The last pose of every object by camera: what an earlier frame says about this one.

Evidence fades with time, and each frame's own evidence is added to what is left: a flip that was decided
wrongly once is overruled by the following frames, and a pose on which several markers agreed rules at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from common.geometry import Pose
from services.label.pose import BoxPose, Prior

LIFETIME_NS = 500_000_000
"""An older pose says nothing."""
HALF_LIFE_NS = 250_000_000
"""In this time evidence loses half its weight."""


@dataclass(frozen=True, eq=False)
class Remembered:
    """A pose and when it was; ``before`` is what was known before that frame (for labelling it again)."""

    pose: Pose
    evidence: float
    confirmed: bool
    mono_ns: int
    before: Remembered | None = None


class LastPoses:
    """The last pose by camera and object."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, str], Remembered] = {}

    def prior(self, camera: str, name: str, mono_ns: int) -> Prior | None:
        """What another frame says about the one of ``mono_ns``; None if none is nearer in time than 0.5 s.

        That frame may be a later one: a recording can ask for a frame that has already passed.
        """
        last = self._before(camera, name, mono_ns)
        if last is None or abs(mono_ns - last.mono_ns) > LIFETIME_NS:
            return None
        faded = 0.5 ** (abs(mono_ns - last.mono_ns) / HALF_LIFE_NS)
        return Prior(last.pose, last.evidence * faded, last.confirmed)

    def remember(self, camera: str, name: str, mono_ns: int, found: BoxPose) -> None:
        """Keep the pose of a frame; one older than what is kept already is passed over."""
        last = self._last.get((camera, name))
        if last is not None and mono_ns < last.mono_ns:
            return
        before = self._before(camera, name, mono_ns)
        self._last[camera, name] = Remembered(
            pose=found.pose,
            evidence=found.evidence,
            confirmed=len(found.markers) > 1,
            mono_ns=mono_ns,
            before=None if before is None else replace(before, before=None),
        )

    def forget(self, camera: str) -> None:
        """Drop a camera's poses (it was restarted or replaced)."""
        self._last = {key: value for key, value in self._last.items() if key[0] != camera}

    def _before(self, camera: str, name: str, mono_ns: int) -> Remembered | None:
        """The newest pose that isn't of this very frame: a frame is labelled again when it is recorded."""
        last = self._last.get((camera, name))
        return last.before if last is not None and last.mono_ns == mono_ns else last
