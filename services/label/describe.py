"""A posed object as it is written into labels. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from common.geometry import Box, CameraModel, Pose
from common.labels import Corner, ObjectLabel, Quality, SideLabel, Uncertainty
from services.label.occlusion import DepthPicture, Seen, look
from services.label.pose import BoxPose, MarkerFit
from services.label.visibility import marker_angle
from services.label.windows import project_box, side_polygon

PoseSource = Literal["measured", "tracked", "interpolated"]


@dataclass(frozen=True, eq=False)
class Posed:
    """A box with its pose (object to camera frame), where that came from, and its error bar where it was asked for.

    ``found`` is what its markers gave; None if the pose is interpolated.
    """

    box: Box
    pose: Pose
    found: BoxPose | None
    source: PoseSource = "measured"
    bar: Uncertainty | None = None


def object_label(id_: int, posed: Posed, camera: CameraModel, seen: Seen | None) -> ObjectLabel:
    """The object's part of the label; ``seen`` is what of it is visible, where that was looked at."""
    box, pose, found = posed.box, posed.pose, posed.found
    projected = project_box(box, pose, camera)
    fits = () if found is None else found.markers
    sides = sorted((_side_label(box, fit, pose, camera, seen) for fit in fits), key=_facing)
    alternative = None if found is None or found.alternative is None else found.alternative.label()
    return ObjectLabel(
        id=id_,
        name=box.name,
        type=box.type,
        pose_source=posed.source,
        sides=tuple(sides),
        pose=pose.label(),
        corners=projected.corners if seen is None else _with_visibility(projected.corners, seen),
        window=projected.window,
        window_unclipped=projected.window_unclipped,
        distance_mm=float(np.linalg.norm(pose.translation)),
        quality=Quality(
            reprojection_error_px=0.0 if found is None else found.residual_px,
            markers=len(fits),
            ambiguous=alternative is not None,
            alternative_pose=alternative,
            uncertainty=posed.bar,
        ),
        faces=() if seen is None else seen.faces,
        visibility=None if seen is None else ("depth" if seen.by_depth else "geometry"),
    )


def what_is_seen(posed: Sequence[Posed], camera: CameraModel, depth: DepthPicture | None) -> list[Seen]:
    """What is visible of each object, all of them in one picture."""
    found = []
    for item in posed:
        others = [(other.box, other.pose) for other in posed if other is not item]
        sigma = 0.0 if item.bar is None else item.bar.distance_mm
        found.append(look(item.box, item.pose, camera, others, depth, sigma))
    return found


def _with_visibility(corners: tuple[Corner, ...], seen: Seen) -> tuple[Corner, ...]:
    pairs = zip(corners, seen.corners, strict=True)
    return tuple(corner.model_copy(update={"visible": bool(visible)}) for corner, visible in pairs)


def _facing(side: SideLabel) -> float:
    return side.viewing_angle_deg


def _side_label(box: Box, fit: MarkerFit, pose: Pose, camera: CameraModel, seen: Seen | None) -> SideLabel:
    side, marker = fit.seen.side, fit.seen.marker
    centre = pose.rotation @ box.marker_pose(side, marker).translation + pose.translation
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
            "visible_share": None if seen is None else seen.share(side.face),
        }
    )
