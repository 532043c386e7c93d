"""What two cameras saw at the same moment: from recorded sessions, or live of a board that is held still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from common.boards import Board
from common.bus import Endpoints
from common.calibration import BoardFinder, View, is_new
from common.calibration.diversity import difference
from common.calibration.extrinsics import Pair, Sight
from common.calibration.guide import STILL_SHARE
from common.calibration.start import pose_of
from common.config import Rig
from common.dataset import SessionReader
from common.errors import RefusedError
from common.geometry import CameraModel, Pose
from common.labels import CameraLabel, Label, ObjectLabel
from tools.calibrate.feed import Feed

ENOUGH_PAIRS = 20
_TOGETHER_NS = 100_000_000
"""A board that is still may be seen by the second camera so much later."""


@dataclass
class Seen:
    """Pairs of two cameras and how these describe themselves; ``skipped``: frames not taken, by why."""

    pairs: list[Pair] = field(default_factory=list)
    cameras: list[CameraLabel] = field(default_factory=list)
    skipped: dict[str, int] = field(default_factory=dict)

    def skip(self, why: str) -> None:
        """Count one that was not taken."""
        self.skipped[why] = self.skipped.get(why, 0) + 1


def from_session(folder: Path, rig: Rig, first: str, second: str, within_ms: float) -> Seen:
    """Objects in samples that `record --camera all` took together. Raises RefusedError, DatasetError."""
    reader, seen = SessionReader(folder), Seen()
    corners = {
        (box.name, marker.id): box.marker_corners(side, marker) for box in rig.boxes for side, marker in box.markers()
    }
    names = set(reader.samples())
    for name in sorted(names):
        label = reader.label(name)
        other = None if label.pair is None else label.pair.samples.get(second)
        if label.camera.name != first or label.pair is None or other not in names:
            continue
        partner = reader.label(other)
        if partner.pair is None:
            continue
        if abs(label.pair.offset_ms - partner.pair.offset_ms) > within_ms:
            seen.skip(f"taken more than {within_ms:g} ms apart")
            continue
        seen.cameras = [label.camera, partner.camera]
        seen.pairs += _of_samples(label, partner, corners)
    if not seen.cameras and seen.skipped:
        raise RefusedError(
            f"the samples of {folder} that {first} and {second} took together lie more than {within_ms:g} ms apart; "
            "if nothing moved, allow more with --within-ms",
            code="no_views",
        )
    if not seen.cameras:
        raise RefusedError(
            f"{folder} holds no samples that {first} and {second} took together; record with --camera all",
            code="no_views",
        )
    return seen


def _of_samples(label: Label, partner: Label, corners: dict[tuple[str, int], np.ndarray]) -> list[Pair]:
    others = {item.name: item for item in partner.objects}
    return [
        Pair(f"{label.sample}: {item.name}", _sight(item, corners), _sight(others[item.name], corners))
        for item in label.objects
        if item.name in others
    ]


def _sight(item: ObjectLabel, corners: dict[tuple[str, int], np.ndarray]) -> Sight:
    known = [side for side in item.sides if (item.name, side.marker) in corners]
    points = [corners[item.name, side.marker] for side in known] or [np.zeros((0, 3))]
    pixels = [np.array(side.marker_corners) for side in known] or [np.zeros((0, 2))]
    return Sight(np.concatenate(points), np.concatenate(pixels), Pose.from_label(item.pose))


class LivePairs:
    """Takes a pair whenever the board is still and new before both cameras; ``count`` of them, or until Ctrl-C."""

    def __init__(self, board: Board, endpoints: Endpoints, first: str, second: str) -> None:
        self.seen = Seen()
        self.interrupted = False
        self._finder = BoardFinder(board)
        self._endpoints = endpoints
        self._names = (first, second)
        self._taken: list[View] = []
        self._before: tuple[View, View] | None = None

    def run(self, show: Callable[[str], None], count: int = ENOUGH_PAIRS) -> Seen:
        """Raises RefusedError if a camera gives no pictures, or has no calibration."""
        with Feed(self._endpoints, self._names[0]) as first, Feed(self._endpoints, self._names[1]) as second:
            last = 0
            try:
                while len(self.seen.pairs) < count:
                    first.listen(0.05)
                    second.listen(0.0)
                    ref = first.newest()
                    if ref is None or ref.captured_mono_ns == last or first.state is None or second.state is None:
                        continue
                    last = ref.captured_mono_ns
                    self.seen.cameras = [first.state.camera, second.state.camera]
                    views = self._views(first, second, ref.captured_mono_ns)
                    show(self.offer(views))
            except KeyboardInterrupt:
                self.interrupted = True
        return self.seen

    def _views(self, first: Feed, second: Feed, mono_ns: int) -> tuple[View, View] | None:
        found = []
        for feed in (first, second):
            ref = feed.nearest(mono_ns)
            if ref is None or abs(ref.captured_mono_ns - mono_ns) > _TOGETHER_NS:
                return None
            picture = feed.read(ref)
            view = None if picture is None else self._finder.find(picture, f"{feed.name} frame {ref.frame}")
            if not isinstance(view, View):
                return None
            found.append(view)
        return found[0], found[1]

    def offer(self, views: tuple[View, View] | None) -> str:
        """The board in the newest pictures of both (None: not in both); takes them if it is still and new; words."""
        before, self._before = self._before, views
        if views is None:
            return "show the board to both cameras at once"
        if before is None or any(difference(a, b) > STILL_SHARE for a, b in zip(views, before, strict=True)):
            return "both cameras see it: hold it still"
        if not is_new(views[0], self._taken):
            return f"{len(self.seen.pairs)} pairs; move the board to another place, tilted otherwise"
        self._taken.append(views[0])
        sights = [_board_sight(view, label) for view, label in zip(views, self.seen.cameras, strict=True)]
        self.seen.pairs.append(Pair(f"pair {len(self.seen.pairs) + 1}", sights[0], sights[1]))
        return f"pair {len(self.seen.pairs)} is taken; move the board to another place, tilted otherwise"


def _board_sight(view: View, label: CameraLabel) -> Sight:
    pose = pose_of(view, CameraModel.from_label(label))
    return Sight(view.points, view.corners, Pose.from_rvec(pose[:3], pose[3:]))
