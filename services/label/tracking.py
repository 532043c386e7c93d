"""Poses of objects whose markers were not detected: found again where they must be, or interpolated. Pure."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from common.errors import PoseError
from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.labels import Quad
from common.markers import Family
from common.messages import DetectedMarker
from services.label.describe import Posed
from services.label.pose import CERTAIN, Prior, solve_box
from services.label.refine import refine
from services.label.sightings import Expected
from services.label.uncertainty import of_spread, uncertainty
from services.label.visibility import faces_camera
from services.label.visible_objects import SeenMarker

Picture = NDArray[np.uint8]

MAX_RESIDUAL = 0.15
"""Of the contrast: nobody read the marker's id here, so its pattern must show more clearly than in a detected one."""


def interpolated(box: Box, expected: Expected, camera: CameraModel) -> Posed | None:
    """The pose between the frames before and after; None where it isn't known in both."""
    between = expected.between()
    if between is None:
        return None
    pose, spread = between
    return Posed(box, pose, None, "interpolated", of_spread(box, pose, spread, camera))


def tracked(
    box: Box,
    expected: Expected,
    picture: Picture,
    camera: CameraModel,
    family: Family,
    ambiguous_px: float,
    detected: Collection[int],
) -> Posed | None:
    """The pose from markers that nobody detected, but whose pattern is where the frames around put it.

    Those that were ``detected`` gave no pose already. None where no pattern is found, or the poses stay two.
    """
    guess = expected.guess()
    seen = []
    for side, marker in box.markers():
        start = None if marker.id in detected else _where(box, side, marker, guess, camera)
        if start is None:
            continue
        found = refine(
            picture, DetectedMarker(id=marker.id, corners=start, kind="predicted"), family, camera, marker.margin
        )
        if found.converged and found.residual <= MAX_RESIDUAL:
            exact = DetectedMarker(id=marker.id, corners=found.corners, kind=found.kind)
            seen.append(SeenMarker(side, marker, exact, found.covariance))
    if not seen:
        return None
    try:
        pose = solve_box(box, seen, camera, ambiguous_px, Prior(guess, CERTAIN, confirmed=True))
    except PoseError:
        return None
    if pose.ambiguous or pose.contradicting:
        return None
    return Posed(box, pose.pose, pose, "tracked", uncertainty(box, pose, camera))


def _where(box: Box, side: BoxSide, marker: MarkerOnSide, pose: Pose, camera: CameraModel) -> Quad | None:
    """A marker's corners where a pose puts them; None if it is turned away or not wholly in the picture."""
    if not faces_camera(pose, box, side, marker):
        return None
    pixels, front = camera.project(pose.apply(box.marker_corners(side, marker)))
    if not (front.all() and camera.contains(pixels).all()):
        return None
    top_left, top_right, bottom_right, bottom_left = ((float(x), float(y)) for x, y in pixels)
    return top_left, top_right, bottom_right, bottom_left
