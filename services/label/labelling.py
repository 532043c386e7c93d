"""From a frame's markers to its label: the paper's steps in their order. Knows only what earlier frames showed.

sort markers into objects -> refine corners -> settle ids seen twice -> joint pose -> corners, window, sides.
A frame that is kept also gets what its markers don't tell: objects that are tracked or interpolated, what of each
is visible, and which objects are missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.config.models import PoseConfig
from common.errors import PoseError
from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import LeftOut, Missing, ObjectLabel
from common.markers import Family, family
from common.messages import DetectedMarker
from services.label.continuity import LastPoses
from services.label.copies import settle_copies
from services.label.describe import Posed, object_label, what_is_seen
from services.label.occlusion import DepthPicture
from services.label.pose import BoxPose, Prior, solve_box
from services.label.refine import refine
from services.label.sightings import Expected, Sightings, in_view
from services.label.tracking import interpolated, tracked
from services.label.uncertainty import quick_uncertainty, uncertainty
from services.label.visibility import faces_camera
from services.label.visible_objects import (
    SeenMarker,
    VisibleObject,
    doubted,
    left_out,
    not_detected,
    sort_markers,
)

if TYPE_CHECKING:
    from common.config import Rig

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Labelled:
    """The objects of a frame (ids 0, 1, ... in rig order) and every marker that gave no side, with the reason.

    Each detected marker is in exactly one of the two. ``missing`` objects are in view but have no pose.
    """

    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...]
    missing: tuple[Missing, ...] = ()


@dataclass(frozen=True, eq=False)
class Around:
    """What the frames around a frame say of it; plain data, for a worker process.

    ``previous``: of poses, to decide between two; ``expected``: objects that were seen just before. ``steady``: the
    frame is one of a stream; else (a folder of photos) it stands alone, and nothing is expected of it.
    """

    previous: Mapping[str, Prior]
    expected: tuple[Expected, ...] = ()
    steady: bool = False


ALONE = Around({})


class Labeller:
    """Labels frames of any number of cameras; its only state is where each camera saw each object lately."""

    def __init__(self, boxes: Sequence[Box], family: Family, options: PoseConfig) -> None:
        self.boxes = tuple(boxes)
        self._family = family
        self._options = options
        self._last = LastPoses()
        self._sightings = Sightings()

    @classmethod
    def of(cls, rig: Rig) -> Labeller:
        """For the objects of a rig; raises ConfigError if its marker family doesn't exist."""
        return cls(rig.boxes, family(rig.config.markers.family, rig.folder), rig.config.pose)

    def label(
        self,
        markers: Sequence[DetectedMarker],
        camera: CameraModel,
        camera_name: str,
        mono_ns: int,
        bgr: Picture | None = None,
    ) -> Labelled:
        """Label one frame of a stream, captured at ``mono_ns``, and remember its poses.

        With its picture (H, W, 3) or (H, W) the corners of configured markers are refined first (for frames that
        are recorded or previewed); without it the detector's coarse corners are used. The same frame may be
        labelled twice, once without and once with its picture. Time that runs backwards begins another stream.
        """
        if not self._sightings.looked(camera_name, mono_ns):
            self._last.forget(camera_name)
        around = self.around(camera_name, mono_ns)
        labelled, posed = self._frame(markers, camera, bgr, around, None)
        for item in posed:
            if item.found is not None and item.source == "measured":
                self._last.remember(camera_name, item.box.name, mono_ns, item.found)
                self._sightings.saw(camera_name, item.box.name, mono_ns, item.found)
        return labelled

    def label_once(
        self,
        markers: Sequence[DetectedMarker],
        camera: CameraModel,
        bgr: Picture | None = None,
        around: Around = ALONE,
        depth: DepthPicture | None = None,
    ) -> Labelled:
        """Label one frame from what is given alone (what another labeller knows ``around`` it, say).

        With its picture the label is complete: also objects that are tracked or interpolated, and what is visible.
        """
        return self._frame(markers, camera, bgr, around, depth)[0]

    def around(self, camera_name: str, mono_ns: int) -> Around:
        """What other frames of a camera's stream say about the frame of ``mono_ns``."""
        known = ((box.name, self._last.prior(camera_name, box.name, mono_ns)) for box in self.boxes)
        expected = (self._sightings.expected(camera_name, box.name, mono_ns) for box in self.boxes)
        return Around(
            previous={name: prior for name, prior in known if prior is not None},
            expected=tuple(item for item in expected if item is not None),
            steady=True,
        )

    def forget(self, camera_name: str) -> None:
        """Drop what is known of a camera's earlier frames."""
        self._last.forget(camera_name)
        self._sightings.forget(camera_name)

    def _frame(
        self,
        markers: Sequence[DetectedMarker],
        camera: CameraModel,
        bgr: Picture | None,
        around: Around,
        depth: DepthPicture | None,
    ) -> tuple[Labelled, list[Posed]]:
        sorted_ = sort_markers(markers, self.boxes)
        posed: dict[str, Posed] = {}
        out = [LeftOut(marker=seen.id, reason="unknown_marker", corners=seen.corners) for seen in sorted_.unknown]
        for visible in sorted_.objects:
            box = visible.box
            refined = visible if bgr is None else self._refined(visible, bgr, camera)
            found, reasons = self._pose(refined, camera, around.previous.get(box.name))
            out += reasons
            if found is not None:
                bar = quick_uncertainty if bgr is None else uncertainty
                posed[box.name] = Posed(box, found.pose, found, bar=bar(box, found, camera))
            out += _undetected(visible, None if found is None else found.pose, camera)
        out += [not_detected(marker, box) for box in sorted_.unseen for _, marker in box.markers()]
        if bgr is not None:
            posed |= self._recovered(posed, out, around, bgr, camera)
        ordered = [posed[box.name] for box in self.boxes if box.name in posed]
        seen_of = what_is_seen(ordered, camera, depth) if bgr is not None else [None] * len(ordered)
        labels = (
            object_label(id_, item, camera, seen) for id_, (item, seen) in enumerate(zip(ordered, seen_of, strict=True))
        )
        sides = {fit.seen.marker.id for item in ordered if item.found is not None for fit in item.found.markers}
        out = [entry for entry in out if entry.reason != "not_detected" or entry.marker not in sides]
        return Labelled(tuple(labels), tuple(out), self._missing(posed, out, around, camera)), ordered

    def _recovered(
        self, posed: Mapping[str, Posed], out: Sequence[LeftOut], around: Around, bgr: Picture, camera: CameraModel
    ) -> dict[str, Posed]:
        """Objects that their detected markers gave no pose, but that were seen just before (and after)."""
        boxes = {box.name: box for box in self.boxes if box.name not in posed}
        detected = {entry.marker for entry in out if entry.corners is not None}
        found: dict[str, Posed] = {}
        for item in around.expected:
            box = boxes.get(item.name)
            if box is None:
                continue
            again = tracked(box, item, bgr, camera, self._family, self._options.ambiguous_px, detected)
            again = again or interpolated(box, item, camera)
            others = [(other.box, other.pose) for other in posed.values()]
            if again is not None and in_view(box, again.pose, camera, others):
                found[box.name] = again
        return found

    def _missing(
        self, posed: Mapping[str, Posed], out: Sequence[LeftOut], around: Around, camera: CameraModel
    ) -> tuple[Missing, ...]:
        """Objects that should have a pose: their markers were seen, or they were just before and can't be gone."""
        if not around.steady or len(posed) == len(self.boxes):
            return ()
        expected = {item.name: item for item in around.expected}
        why = {entry.object: entry.reason for entry in out if entry.corners is not None}
        others = [(item.box, item.pose) for item in posed.values()]
        found = []
        for box in self.boxes:
            item = expected.get(box.name)
            if box.name in posed or (item is None and box.name not in why):
                continue
            if box.name not in why and item is not None and not in_view(box, item.guess(), camera, others):
                continue
            ago = None if item is None else round(item.seen_ms_ago, 1)
            found.append(Missing(object=box.name, reason=why.get(box.name, "not_detected"), seen_ms_ago=ago))
        return tuple(found)

    def _pose(
        self, visible: VisibleObject, camera: CameraModel, prior: Prior | None
    ) -> tuple[BoxPose | None, list[LeftOut]]:
        """The object's pose, if there is one, and the seen markers that gave no side."""
        box, limit = visible.box, self._options.ambiguous_px
        markers, doubtful = settle_copies(visible, camera, limit, prior)
        out = [left_out(copy, "duplicate_marker", box) for copy in doubtful]
        if not markers:
            return None, out
        try:
            found = solve_box(box, markers, camera, limit, prior)
        except PoseError as error:
            return None, out + [left_out(marker, error.code, box) for marker in markers]
        out += [_contradicting(marker, box, found.pose, camera) for marker in found.contradicting]
        return found, out + [left_out(marker, "bad_pose", box) for marker in found.unsound]

    def _refined(self, visible: VisibleObject, bgr: Picture, camera: CameraModel) -> VisibleObject:
        def better(marker: SeenMarker) -> SeenMarker:
            found = refine(bgr, marker.seen, self._family, camera, marker.marker.margin)
            if not found.converged:
                return marker if found.doubt_px is None else doubted(marker, found.doubt_px)
            exact = DetectedMarker(id=marker.seen.id, corners=found.corners, kind=found.kind)
            return replace(marker, seen=exact, covariance=found.covariance)

        copies = tuple(tuple(better(copy) for copy in group) for group in visible.copies)
        return replace(visible, markers=tuple(better(marker) for marker in visible.markers), copies=copies)


def _undetected(visible: VisibleObject, pose: Pose | None, camera: CameraModel) -> list[LeftOut]:
    """Markers that were not seen though they should be: not those that the pose turns away or puts outside."""
    box = visible.box
    seen = {marker.marker.id for marker in visible.markers} | {group[0].marker.id for group in visible.copies}
    missing = [(side, marker) for side, marker in box.markers() if marker.id not in seen]
    if pose is not None:
        missing = [(side, marker) for side, marker in missing if _should_be_seen(box, side, marker, pose, camera)]
    return [not_detected(marker, box) for _, marker in missing]


def _should_be_seen(box: Box, side: BoxSide, marker: MarkerOnSide, pose: Pose, camera: CameraModel) -> bool:
    if not faces_camera(pose, box, side, marker):
        return False
    pixels, _ = camera.project(pose.apply(box.marker_corners(side, marker)))
    return bool(camera.contains(pixels).any())


def _contradicting(marker: SeenMarker, box: Box, pose: Pose, camera: CameraModel) -> LeftOut:
    """The entry of a marker that doesn't lie where the object's others put it, with how far off it is."""
    pixels, front = camera.project(pose.apply(box.marker_corners(marker.side, marker.marker)))
    off = float(np.sqrt(((pixels - marker.corners) ** 2).sum(axis=1).mean())) if front.all() else None
    return left_out(marker, "contradicts", box).model_copy(update={"residual_px": off})
