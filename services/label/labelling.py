"""From a frame's markers to its label: the paper's steps in their order. Knows only the last poses.

sort markers into objects -> refine corners -> settle ids seen twice -> joint pose -> corners, window, sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from common.config.models import PoseConfig
from common.errors import PoseError
from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import LeftOut, ObjectLabel, Quality, SideLabel, Uncertainty
from common.markers import Family, family
from common.messages import DetectedMarker
from services.label.continuity import LastPoses
from services.label.copies import settle_copies
from services.label.pose import BoxPose, MarkerFit, Prior, solve_box
from services.label.refine import refine
from services.label.uncertainty import uncertainty
from services.label.visibility import faces_camera, marker_angle
from services.label.visible_objects import SeenMarker, VisibleObject, left_out, not_detected, sort_markers
from services.label.windows import project_box, side_polygon

if TYPE_CHECKING:
    from common.config import Rig

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Labelled:
    """The objects of a frame (ids 0, 1, ... in rig order) and every marker that gave no side, with the reason.

    Each detected marker is in exactly one of the two.
    """

    objects: tuple[ObjectLabel, ...]
    left_out: tuple[LeftOut, ...]


class Labeller:
    """Labels frames of any number of cameras; its only state are the last poses by camera and object."""

    def __init__(self, boxes: Sequence[Box], family: Family, options: PoseConfig) -> None:
        self.boxes = tuple(boxes)
        self._family = family
        self._options = options
        self._last = LastPoses()

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
        """Label one frame, captured at ``mono_ns``, and remember its poses.

        With its picture (H, W, 3) or (H, W) the corners of configured markers are refined first (for frames that
        are recorded or previewed); without it the detector's coarse corners are used. The same frame may be
        labelled twice, once without and once with its picture.
        """
        labelled, found = self._frame(markers, camera, bgr, self.previous(camera_name, mono_ns))
        for name, pose in found.items():
            self._last.remember(camera_name, name, mono_ns, pose)
        return labelled

    def label_once(
        self,
        markers: Sequence[DetectedMarker],
        camera: CameraModel,
        bgr: Picture | None = None,
        previous: Mapping[str, Prior] | None = None,
    ) -> Labelled:
        """Label one frame from what is given alone (``previous`` of another labeller, say); remembers nothing."""
        return self._frame(markers, camera, bgr, previous or {})[0]

    def previous(self, camera_name: str, mono_ns: int) -> dict[str, Prior]:
        """What other frames of a camera say, by object, about the frame of ``mono_ns``; plain data."""
        known = ((box.name, self._last.prior(camera_name, box.name, mono_ns)) for box in self.boxes)
        return {name: prior for name, prior in known if prior is not None}

    def forget(self, camera_name: str) -> None:
        """Drop what is known of a camera's earlier frames."""
        self._last.forget(camera_name)

    def _frame(
        self,
        markers: Sequence[DetectedMarker],
        camera: CameraModel,
        bgr: Picture | None,
        previous: Mapping[str, Prior],
    ) -> tuple[Labelled, dict[str, BoxPose]]:
        sorted_ = sort_markers(markers, self.boxes)
        grey = None if bgr is None else _grey(bgr)
        labels: list[ObjectLabel] = []
        poses: dict[str, BoxPose] = {}
        out = [LeftOut(marker=seen.id, reason="unknown_marker", corners=seen.corners) for seen in sorted_.unknown]
        for visible in sorted_.objects:
            refined = visible if grey is None else self._refined(visible, grey, camera)
            found, reasons = self._pose(refined, camera, previous.get(visible.box.name))
            out += reasons
            if found is not None:
                poses[visible.box.name] = found
                bar = None if grey is None else uncertainty(visible.box, found, camera)
                labels.append(_object_label(len(labels), visible.box, found, camera, bar))
            out += _undetected(visible, None if found is None else found.pose, camera)
        out += [not_detected(marker, box) for box in sorted_.unseen for _, marker in box.markers()]
        return Labelled(tuple(labels), tuple(out)), poses

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
        out += [left_out(marker, "contradicts", box) for marker in found.contradicting]
        return found, out + [left_out(marker, "bad_pose", box) for marker in found.unsound]

    def _refined(self, visible: VisibleObject, grey: Picture, camera: CameraModel) -> VisibleObject:
        def better(marker: SeenMarker) -> SeenMarker:
            found = refine(grey, marker.seen, self._family, camera)
            if not found.converged:
                return marker
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
    pixels, _ = camera.project(pose.apply(box.marker_corners(side, marker)))
    return faces_camera(pose, box, side, marker) and bool(camera.contains(pixels).any())


def _object_label(id_: int, box: Box, found: BoxPose, camera: CameraModel, bar: Uncertainty | None) -> ObjectLabel:
    projected = project_box(box, found.pose, camera)
    sides = sorted((_side_label(box, fit, found.pose, camera) for fit in found.markers), key=_facing)
    return ObjectLabel(
        id=id_,
        name=box.name,
        type=box.type,
        sides=tuple(sides),
        pose=found.pose.label(),
        corners=projected.corners,
        window=projected.window,
        window_unclipped=projected.window_unclipped,
        distance_mm=float(np.linalg.norm(found.pose.translation)),
        quality=Quality(
            reprojection_error_px=found.residual_px,
            markers=len(found.markers),
            ambiguous=found.ambiguous,
            alternative_pose=None if found.alternative is None else found.alternative.label(),
            uncertainty=bar,
        ),
    )


def _facing(side: SideLabel) -> float:
    return side.viewing_angle_deg


def _side_label(box: Box, fit: MarkerFit, pose: Pose, camera: CameraModel) -> SideLabel:
    side, marker = fit.seen.side, fit.seen.marker
    centre = pose.apply(box.marker_pose(side, marker).translation)[0]
    return SideLabel.model_validate(
        {
            "class": side.class_name,
            "face": side.face,
            "marker": marker.id,
            "marker_corners": fit.seen.seen.corners,
            "corners_kind": fit.seen.seen.kind,
            "distance_mm": float(np.linalg.norm(fit.own.translation)),
            "distance_joint_mm": float(np.linalg.norm(centre)),
            "viewing_angle_deg": marker_angle(pose, box, side, marker),
            "residual_px": fit.residual_px,
            "polygon": side_polygon(box, side.face, pose, camera),
        }
    )


def _grey(picture: Picture) -> Picture:
    return picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
