"""The pose of a configured box from all its visible markers together. Pure.

Each marker alone has up to two poses (a small square looks alike when its tilt is mirrored). The object's other
markers decide, then the pose just before (``services.label.continuity``); where nothing decides, both are told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import Box, CameraModel, Pose
from services.label.agreement import View, agreeing, view_of, without_each
from services.label.fit import Fit, Observed, covariance_of, join, refine, residual_px
from services.label.visible_objects import SeenMarker

Array = NDArray[np.float64]

DECIDED = 9.0
"""Two poses whose costs (squared, in units of the corner noise) differ by this are told apart: three sigma."""
CERTAIN = 25.0
"""The evidence (same unit) of a pose that has no rival."""
DISPUTED = 4.0
"""Markers whose joint fit leaves so many times the variance that their corners promise disagree, if tolerably."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What an earlier frame says: the pose then, and how much it counts now (unit of ``DECIDED``)."""

    pose: Pose
    evidence: float
    confirmed: bool = False
    """Whether two or more markers agreed on it: then it may arbitrate between two that don't."""


@dataclass(frozen=True, eq=False)
class MarkerFit:
    """One marker under the joint pose. ``own`` is the marker's own pose (marker to camera frame)."""

    seen: SeenMarker
    own: Pose
    residual_px: float


@dataclass(frozen=True, eq=False)
class BoxPose:
    """The pose of a box (object to camera frame) and how far to trust it.

    ``contradicting`` markers don't fit together with the others, ``unsound`` ones give no pose at all.
    ``evidence`` is by how much (unit of ``DECIDED``) it beats the alternative; ``information`` as in ``Fit``, of
    the corners ``observed``. ``rivals`` are the fit's other minima with their odds against ``pose``, ``inflation``
    is by how much the corners' variance is larger than their kind promises. ``disputed``: where the markers agree less
    than their corners' noise allows, the poses without each of them.
    """

    pose: Pose
    markers: tuple[MarkerFit, ...]
    contradicting: tuple[SeenMarker, ...]
    unsound: tuple[SeenMarker, ...]
    residual_px: float
    evidence: float
    alternative: Pose | None
    information: Array
    observed: Observed
    rivals: tuple[tuple[Pose, float], ...] = ()
    inflation: float = 1.0
    disputed: tuple[Pose, ...] = ()

    @cached_property
    def covariance(self) -> Array:
        """Of a rotation (rad) and a shift (mm) in the camera frame (6, 6), around ``pose`` alone."""
        return covariance_of(self.information) * self.inflation

    @property
    def ambiguous(self) -> bool:
        """Whether nothing decides between ``pose`` and ``alternative``."""
        return self.alternative is not None


def solve_box(
    box: Box, seen: Sequence[SeenMarker], camera: CameraModel, ambiguous_px: float, prior: Prior | None = None
) -> BoxPose:
    """The joint pose of ``box`` from ``seen`` markers (each id once).

    A marker that doesn't fit together with the others is excluded (``contradicting``). Raises PoseError:
    code ``bad_pose`` where no sound pose exists, ``contradicts`` where two markers disagree and nothing decides.
    """
    views = [view for view in (view_of(box, marker, camera) for marker in seen) if view is not None]
    unsound = tuple(marker for marker in seen if all(marker is not view.seen for view in views))
    if not views:
        raise PoseError(f"no marker of {box.name} gives a sound pose", code="bad_pose")
    used, fits = agreeing(box, views, _agreed(prior))
    believed = {id(view.seen) for view in used}
    contradicting = tuple(view.seen for view in views if id(view.seen) not in believed)
    together = join([view.observed for view in used])
    # Corners fit worse than their kind promises when blur or a bent marker spoils them: the noise is then larger.
    inflation = max(1.0, fits[0].cost / max(fits[0].residuals.size - 6, 1))
    best, evidence, alternative = _decide(box, fits, inflation, camera, ambiguous_px, prior)
    rivals = tuple((fit.pose, _odds(fit, best, inflation, prior)) for fit in fits if fit is not best)
    pose = best.pose
    marker_fits = tuple(
        MarkerFit(view.seen, _own_pose(box, view, pose, alone=len(used) == 1), residual_px(view.observed, pose))
        for view in used
    )
    rms = float(np.sqrt((best.residuals**2).sum(axis=1).mean()))
    return BoxPose(
        pose=pose,
        markers=marker_fits,
        contradicting=contradicting,
        unsound=unsound,
        residual_px=rms,
        evidence=evidence,
        alternative=alternative,
        information=best.information,
        observed=together,
        rivals=rivals,
        inflation=inflation,
        disputed=without_each(used, pose) if len(used) > 1 and inflation > DISPUTED else (),
    )


def corner_distance(box: Box, first: Pose, second: Pose, camera: CameraModel) -> float:
    """Largest distance (px) between the box's eight corners projected by two poses; inf behind the camera."""
    one, front_one = camera.project(first.apply(box.corners))
    two, front_two = camera.project(second.apply(box.corners))
    if not (front_one.all() and front_two.all()):
        return float("inf") if first.angle_to(second) > 1e-3 else 0.0
    return float(np.linalg.norm(one - two, axis=1).max())


def _agreed(prior: Prior | None) -> Pose | None:
    """The earlier pose if several markers agreed on it and it still counts."""
    return prior.pose if prior is not None and prior.confirmed and prior.evidence > 0 else None


def _decide(
    box: Box, fits: list[Fit], inflation: float, camera: CameraModel, ambiguous_px: float, prior: Prior | None
) -> tuple[Fit, float, Pose | None]:
    """The pose to use, its evidence, and the alternative where nothing decides between the two."""
    best = fits[0]
    # Several starts may have led to one minimum; a rival is one that puts the box elsewhere.
    rivals = (fit for fit in fits[1:] if corner_distance(box, best.pose, fit.pose, camera) > ambiguous_px)
    other = next(rivals, None)
    if other is None:
        return best, CERTAIN, None
    evidence = (other.cost - best.cost) / inflation
    if prior is not None:
        evidence += _prior_evidence(best.pose, other.pose, prior)
    if evidence < 0:
        best, other, evidence = other, best, -evidence
    return best, min(evidence, CERTAIN), None if evidence >= DECIDED else other.pose


def _odds(rival: Fit, best: Fit, inflation: float, prior: Prior | None) -> float:
    """How likely a rival is against the pose that was chosen, at most 1."""
    evidence = (rival.cost - best.cost) / inflation
    if prior is not None:
        evidence += _prior_evidence(best.pose, rival.pose, prior)
    return float(np.exp(-0.5 * max(evidence, 0.0)))


def _prior_evidence(best: Pose, other: Pose, prior: Prior) -> float:
    """Signed evidence of an earlier pose for ``best`` against ``other``; 0 where it is near neither or both."""
    to_best, to_other = prior.pose.angle_to(best), prior.pose.angle_to(other)
    if min(to_best, to_other) > np.radians(30.0) or max(to_best, to_other) < 2 * min(to_best, to_other):
        return 0.0
    return prior.evidence if to_best < to_other else -prior.evidence


def _own_pose(box: Box, view: View, joint: Pose, *, alone: bool) -> Pose:
    """The marker's own pose: of its two, refined on its four corners, the one nearer to the joint pose."""
    on_box = box.marker_pose(view.seen.side, view.seen.marker)
    if alone:
        return joint.after(on_box)
    nearest = min(view.starts, key=joint.angle_to)
    fit = refine(view.observed, nearest)
    return (fit.pose if fit is not None else nearest).after(on_box)
