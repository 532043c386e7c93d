"""Refined corners on a real, handheld video: the distance between its two tags is constant, its value isn't known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from common.geometry import CameraModel, marker_points
from common.markers import family
from services.detect.markers import open_detector
from services.label.refine import refine

MATRIX = np.array([[2142.5, 0, 993.7], [0, 2142.7, 543.0], [0, 0, 1]])
LENS = np.array([0.514, -6.091, 0.001, 0.001, 19.87])
SIZE_MM = 165.1
EVERY = 4


def place(corners: object) -> np.ndarray:
    """The marker's centre (3,) mm in the camera frame, by cv2 alone."""
    points = marker_points(SIZE_MM).reshape(-1, 1, 3)
    pixels = np.array(corners).reshape(-1, 1, 2)
    _, _, found, _ = cv2.solvePnPGeneric(points, pixels, MATRIX, LENS, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return np.asarray(found[0]).ravel()


def test_the_distance_between_the_tags_is_steady(testdata: Callable[[str], Path]) -> None:
    video = cv2.VideoCapture(str(testdata("wpical/two_tags.mp4")))
    tags = family("apriltag_36h11", Path())
    detector, camera = open_detector(tags, Path()), CameraModel(1920, 1080, MATRIX, LENS)
    coarse, fine = [], []
    number = 0
    while video.grab():
        number += 1
        if number % EVERY != 1:
            continue
        grey = cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2GRAY)
        seen = {marker.id: marker for marker in detector.detect(grey)}
        assert set(seen) == {3, 4}
        refined = [refine(grey, seen[i], tags, camera) for i in (3, 4)]
        assert all(one.converged for one in refined)
        coarse.append(np.linalg.norm(place(seen[3].corners) - place(seen[4].corners)))
        fine.append(np.linalg.norm(place(refined[0].corners) - place(refined[1].corners)))
    assert number == 159
    assert np.std(fine, ddof=1) < 1.4
    assert np.std(fine, ddof=1) < np.std(coarse, ddof=1)
    # The focal length is known to 2 % only, so no more can be said of the mean.
    assert abs(np.mean(fine) - 605.4) < 0.02 * 605.4
