"""Which of an object's markers are believed: the largest set that agrees on one pose. Pure.

What a marker weighs is what its corners tell, whatever their order: corners that by themselves are no picture of a
square are off by more than their kind promises, and count that much less. Of markers that contradict each other those
are kept that fit together better by far; of two, the one whose own corners are sound if the other's aren't. An earlier
pose speaks only against a marker that is grossly elsewhere, for the object may have moved since. Else it stays open
which of them is wrong, and a wrong label is worse than none (docs/decisions/0015).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import FACES, Box, CameraModel, Pose
from common.labels import FaceName
from services.label.fit import Fit, Observed, join, misfit, observe, refine, residual_px, square_poses
from services.label.visibility import faces_camera
from services.label.visible_objects import SeenMarker

Array = NDArray[np.float64]

MOUNTING_MM = 3.0
"""How far a marker may sit from where the rig file says before it contradicts the object's others."""
SOUND = 9.0
"""A marker's own best pose costs at most this (squared, in units of the corner noise, two degrees of freedom)."""
UNSOUND = 25.0
"""One that costs more than this has corners that are off, whatever their kind promises."""
BETTER = 4.0
"""Markers whose misfit (per degree of freedom) is so many times smaller than others' fit together better by far."""
ELSEWHERE, FARTHER = 1.0, 4.0
"""Grossly elsewhere: so many sides from where an earlier pose has a marker, and so many times as far as its rival."""
_DISTINCT = np.radians(8.0)
"""Starting poses of different markers nearer than this lead to the same minimum."""
_MOST_STARTS = 4
_GOOD = 4.0
"""A fit with residuals up to twice the corner noise is the true minimum, not a mirrored one."""


@dataclass(frozen=True, eq=False)
class View:
    """A seen marker prepared for fitting: corners in the object frame, its own poses as poses of the object.

    ``misfit``: what its own pose costs at least, in units of the noise that its corners' kind promises (``weighed``).
    """

    seen: SeenMarker
    observed: Observed
    starts: tuple[Pose, ...]
    misfit: float = 0.0

    def tolerance_px(self) -> float:
        """Largest residual (px, rms of the corners) of a marker that is what and where it should be."""
        per_mm = self.seen.side_px / self.seen.marker.size_mm
        return 1.0 + 5.0 * self.seen.noise_px + MOUNTING_MM * per_mm


def view_of(box: Box, seen: SeenMarker, camera: CameraModel) -> View | None:
    """None where the corners give no pose at all (degenerate, or outside what the lens model reaches)."""
    on_box = box.marker_pose(seen.side, seen.marker)
    points = box.marker_corners(seen.side, seen.marker)
    observed = observe(points, seen.corners, np.full(4, seen.noise_px), camera, seen.covariance)
    if not observed.finite:
        return None
    own = square_poses(observed.rays, seen.marker.size_mm)
    starts = tuple(pose.after(on_box.inverse()) for pose in own)
    return View(seen, observed, starts) if starts else None


def weighed(view: View) -> View:
    """With the noise that the marker's corners show by themselves, where what their kind promises can't be true."""
    cost = _own_misfit(view.observed, view.starts)
    if cost <= SOUND:
        return replace(view, misfit=cost)
    # Eight coordinates less the six of a pose: as many tell of the noise.
    observed = replace(view.observed, whitening=view.observed.whitening / np.sqrt(cost / 2))
    return replace(view, observed=observed, misfit=cost)


def agreeing(box: Box, views: Sequence[View], earlier: Pose | None) -> tuple[list[View], list[Fit]]:
    """The markers that agree, with the minima of their joint fit, best first.

    ``earlier``: the object's pose just before on which several markers agreed. Raises PoseError: code ``bad_pose``
    where no sound pose exists, ``contradicts`` where markers disagree and nothing decides.
    """
    used = [weighed(view) for view in views] if len(views) > 1 else list(views)
    while True:
        fits = minima(box, used)
        if fits and _disagreement(used, fits) <= 1.0:
            return used, fits
        if len(used) == 1:
            raise PoseError(f"the marker of {box.name} gives no sound pose", code="bad_pose")
        wrong = _odd_one_out(box, used, earlier)
        used = [view for view in used if view is not wrong]


def minima(box: Box, views: Sequence[View]) -> list[Fit]:
    """The sound local minima of the joint fit, best first.

    Markers on one side share the ambiguity of a lone one, so both minima count: the other one lies where the side's
    tilt is mirrored. Markers on several sides leave one. The search ends when these are found.
    """
    together = join([view.observed for view in views])
    faces = {view.seen.side.face for view in views}
    starts = _starts(together, views)
    found: list[Fit] = []
    while starts:
        fit = refine(together, starts.pop(0))
        if fit is None or not all(faces_camera(fit.pose, box, v.seen.side, v.seen.marker) for v in views):
            continue
        found.append(fit)
        if len(views) > 1 and len(found) == 1 and fit.cost <= _GOOD * fit.residuals.size:
            starts = [mirrored(fit.pose, together.points, faces.pop())] if len(faces) == 1 else []
    return sorted(found, key=lambda fit: fit.cost)


def mirrored(pose: Pose, points: Array, face: FaceName) -> Pose:
    """The pose (object to camera frame) that shows points (N, 3) of one face nearly alike, tilted the other way.

    Its normal is mirrored at the sight line to their middle, around which the object turns (Schweighofer and Pinz,
    TPAMI 2006: a plane has at most two such minima).
    """
    middle = pose.apply(points.mean(axis=0))[0]
    sight = middle / math.hypot(*middle)
    normal = -(pose.rotation @ np.array(FACES[face].normal, dtype=np.float64))
    axis = np.cross(normal, sight)
    sine = math.hypot(*axis)
    angle = 2 * math.atan2(sine, float(normal @ sight))
    turn, _ = cv2.Rodrigues(axis * (angle / max(sine, 1e-12)))
    return Pose(turn @ pose.rotation, turn @ (pose.translation - middle) + middle)


def without_each(views: Sequence[View], pose: Pose) -> tuple[Pose, ...]:
    """What the joint pose of several markers would be without one of them, for each of them."""
    rests = ([view.observed for view in views if view is not left] for left in views)
    fits = (refine(join(rest), pose) for rest in rests)
    return tuple(fit.pose for fit in fits if fit is not None)


def _own_misfit(observed: Observed, starts: Sequence[Pose]) -> float:
    """The cost of the best pose of a marker alone; only looked for where the closed form's isn't good enough."""
    cost = min(misfit(observed, start) for start in starts)
    if cost <= SOUND:
        return cost
    fits = [fit for fit in (refine(observed, start) for start in starts) if fit is not None]
    return min([cost, *(fit.cost for fit in fits)])


def _disagreement(views: Sequence[View], fits: Sequence[Fit]) -> float:
    """The largest residual as a share of what is tolerated; inf without a fit."""
    if not fits:
        return float("inf")
    return max(residual_px(view.observed, fits[0].pose) / view.tolerance_px() for view in views)


def _odd_one_out(box: Box, views: list[View], earlier: Pose | None) -> View:
    """The marker to leave out: that without which the others fit together by far the best, if there is one."""
    if len(views) == 2:
        return _the_wrong_of(box, views[0], views[1], earlier)
    ranked = []
    for left in views:
        rest = [view for view in views if view is not left]
        fits = minima(box, rest)
        off = _disagreement(rest, fits)
        # Misfits tell more than residuals as long as the rest agrees at all: they know what each corner is worth.
        per_freedom = max(fits[0].cost / (fits[0].residuals.size - 6), 1.0) if fits else float("inf")
        ranked.append((off > 1.0, off if off > 1.0 else per_freedom, left))
    ranked.sort(key=lambda item: item[:2])
    (open_, best, first), (next_open, second, other) = ranked[:2]
    if open_ or next_open or second > BETTER * best:
        return first
    return _the_wrong_of(box, first, other, earlier)


def _the_wrong_of(box: Box, one: View, two: View, earlier: Pose | None) -> View:
    """Of two markers of which one must be wrong, that one; raises PoseError where nothing decides."""
    better, worse = sorted((one, two), key=lambda view: view.misfit)
    if better.misfit <= SOUND and worse.misfit > UNSOUND:
        return worse
    if earlier is not None:
        off = {id(view): residual_px(view.observed, earlier) / view.seen.side_px for view in (one, two)}
        near, far = sorted((one, two), key=lambda view: off[id(view)])
        if off[id(far)] > max(ELSEWHERE, FARTHER * off[id(near)]):
            return far
    ids = " and ".join(str(view.seen.marker.id) for view in (one, two))
    raise PoseError(
        f"markers {ids} of {box.name} contradict each other; check their places and sizes in the rig file",
        code="contradicts",
    )


def _starts(together: Observed, views: Sequence[View]) -> list[Pose]:
    """The markers' own poses, those that fit all of them best first; of poses nearly alike only the best."""
    starts = sorted((start for view in views for start in view.starts), key=lambda pose: misfit(together, pose))
    if len(views) == 1:
        return starts
    distinct: list[Pose] = []
    for start in starts:
        if all(start.angle_to(other) > _DISTINCT for other in distinct):
            distinct.append(start)
    return distinct[:_MOST_STARTS]
