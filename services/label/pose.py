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
from services.label.fit import Fit, Observed, covariance_of, join, misfit, observe, refine, residual_px, square_poses
from services.label.visibility import faces_camera
from services.label.visible_objects import SeenMarker

Array = NDArray[np.float64]

MOUNTING_MM = 3.0
"""How far a marker may sit from where the rig file says before it contradicts the object's others."""
DECIDED = 9.0
"""Two poses whose costs (squared, in units of the corner noise) differ by this are told apart: three sigma."""
CERTAIN = 25.0
"""The evidence (same unit) of a pose that has no rival."""
_DISTINCT = np.radians(8.0)
"""Starting poses of different markers nearer than this lead to the same minimum."""
_MOST_STARTS = 4
_GOOD = 4.0
"""A fit with residuals up to twice the corner noise is the true minimum, not a mirrored one."""


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
    is by how much the corners' variance is larger than their kind promises.
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

    @cached_property
    def covariance(self) -> Array:
        """Of a rotation (rad) and a shift (mm) in the camera frame (6, 6), around ``pose`` alone."""
        return covariance_of(self.information) * self.inflation

    @property
    def ambiguous(self) -> bool:
        """Whether nothing decides between ``pose`` and ``alternative``."""
        return self.alternative is not None


@dataclass(frozen=True, eq=False)
class _View:
    """A seen marker prepared for fitting: corners in the object frame, own poses as poses of the object."""

    seen: SeenMarker
    observed: Observed
    own: tuple[Pose, ...]
    starts: tuple[Pose, ...]

    def tolerance_px(self) -> float:
        """Largest residual (px, rms of the corners) of a marker that is what and where it should be."""
        per_mm = self.seen.side_px / self.seen.marker.size_mm
        return 1.0 + 5.0 * self.seen.noise_px + MOUNTING_MM * per_mm


def solve_box(
    box: Box, seen: Sequence[SeenMarker], camera: CameraModel, ambiguous_px: float, prior: Prior | None = None
) -> BoxPose:
    """The joint pose of ``box`` from ``seen`` markers (each id once).

    A marker that doesn't fit together with the others is excluded (``contradicting``). Raises PoseError:
    code ``bad_pose`` where no sound pose exists, ``contradicts`` where two markers disagree and nothing decides.
    """
    views = [view for view in (_view(box, marker, camera) for marker in seen) if view is not None]
    unsound = tuple(marker for marker in seen if all(marker is not view.seen for view in views))
    if not views:
        raise PoseError(f"no marker of {box.name} gives a sound pose", code="bad_pose")
    used, fits = _consistent(box, views, prior)
    contradicting = tuple(view.seen for view in views if view not in used)
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
    )


def corner_distance(box: Box, first: Pose, second: Pose, camera: CameraModel) -> float:
    """Largest distance (px) between the box's eight corners projected by two poses; inf behind the camera."""
    one, front_one = camera.project(first.apply(box.corners))
    two, front_two = camera.project(second.apply(box.corners))
    if not (front_one.all() and front_two.all()):
        return float("inf") if first.angle_to(second) > 1e-3 else 0.0
    return float(np.linalg.norm(one - two, axis=1).max())


def _view(box: Box, seen: SeenMarker, camera: CameraModel) -> _View | None:
    """None where the corners give no pose at all (degenerate, or outside what the lens model reaches)."""
    on_box = box.marker_pose(seen.side, seen.marker)
    points = box.marker_corners(seen.side, seen.marker)
    observed = observe(points, seen.corners, np.full(4, seen.noise_px), camera, seen.covariance)
    if not observed.finite:
        return None
    own = square_poses(observed.rays, seen.marker.size_mm)
    starts = tuple(pose.after(on_box.inverse()) for pose in own)
    return _View(seen, observed, own, starts) if own else None


def _consistent(box: Box, views: list[_View], prior: Prior | None) -> tuple[list[_View], list[Fit]]:
    """The largest set of markers that agree, with the minima of their joint fit, best first."""
    used = list(views)
    while True:
        fits = _minima(box, used)
        if fits and all(residual_px(view.observed, fits[0].pose) <= view.tolerance_px() for view in used):
            return used, fits
        if len(used) == 1:
            raise PoseError(f"the marker of {box.name} gives no sound pose", code="bad_pose")
        used = [_arbitrate(box, used, prior)] if len(used) == 2 else _without_worst(box, used)


def _without_worst(box: Box, views: list[_View]) -> list[_View]:
    """Leave out the marker without which the others agree best."""
    rests = [[view for view in views if view is not left] for left in views]

    def disagreement(rest: list[_View]) -> float:
        fits = _minima(box, rest)
        if not fits:
            return float("inf")
        return max(residual_px(view.observed, fits[0].pose) / view.tolerance_px() for view in rest)

    return min(rests, key=disagreement)


def _arbitrate(box: Box, views: list[_View], prior: Prior | None) -> _View:
    """Of two markers that contradict each other, the one that an agreed earlier pose speaks for.

    Without one it stays open which of them is wrong, and a wrong label is worse than none.
    """
    if prior is not None and prior.confirmed and prior.evidence > 0:
        off = [residual_px(view.observed, prior.pose) / view.seen.side_px for view in views]
        near, far = min(off), max(off)
        if near < 0.5 and far > 2 * near:
            return views[off.index(near)]
    ids = " and ".join(str(view.seen.marker.id) for view in views)
    raise PoseError(
        f"markers {ids} of {box.name} contradict each other; check their places and sizes in the rig file",
        code="contradicts",
    )


def _minima(box: Box, views: list[_View]) -> list[Fit]:
    """The sound local minima of the joint fit, best first.

    Markers on one side share the ambiguity of a lone one, so both minima count; markers on several sides leave
    one, and the search ends when it is found.
    """
    together = join([view.observed for view in views])
    flat = len({view.seen.side.face for view in views}) == 1
    found: list[Fit] = []
    for start in _starts(together, views):
        fit = refine(together, start)
        if fit is None or not all(faces_camera(fit.pose, box, v.seen.side, v.seen.marker) for v in views):
            continue
        found.append(fit)
        if not flat and fit.cost <= _GOOD * fit.residuals.size:
            break
    return sorted(found, key=lambda fit: fit.cost)


def _starts(together: Observed, views: list[_View]) -> list[Pose]:
    """The markers' own poses, those that fit all of them best first; of poses nearly alike only the best."""
    starts = sorted((start for view in views for start in view.starts), key=lambda pose: misfit(together, pose))
    if len(views) == 1:
        return starts
    distinct: list[Pose] = []
    for start in starts:
        if all(start.angle_to(other) > _DISTINCT for other in distinct):
            distinct.append(start)
    return distinct[:_MOST_STARTS]


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


def _own_pose(box: Box, view: _View, joint: Pose, *, alone: bool) -> Pose:
    """The marker's own pose: of its two, refined on its four corners, the one nearer to the joint pose."""
    on_box = box.marker_pose(view.seen.side, view.seen.marker)
    if alone:
        return joint.after(on_box)
    nearest = min(view.starts, key=joint.angle_to)
    fit = refine(view.observed, nearest)
    return (fit.pose if fit is not None else nearest).after(on_box)
