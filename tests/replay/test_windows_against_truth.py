"""The whole way from a rendered picture to its label, against the renderer's truth.

Detector, refinement, pose and window as in production, on random frames of two boxes with a marker on five sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config.models import PoseConfig
from common.labels import ObjectLabel, Window
from common.markers import family
from common.messages import TrueObject
from common.scene import Scene
from services.detect.markers import open_detector
from services.label.inpaint import Crop, erase, mask_of, regions
from services.label.labelling import Labelled, Labeller
from tests.replay.scenes import APART, BOXES, CAMERA, FRAME_NS

FAMILY = family("apriltag_36h11", Path())
WHOLE = Crop(0, 0, CAMERA.width, CAMERA.height)


@dataclass(frozen=True)
class Sample:
    """A rendered frame, its truth and its labels from coarse and from refined corners.

    ``sticker`` (H, W): pixels that show a marker: black, paper and their softened edge.
    """

    bgr: np.ndarray
    sticker: np.ndarray
    truth: tuple[TrueObject, ...]
    coarse: Labelled
    refined: Labelled


def _samples(count: int) -> list[Sample]:
    scene = Scene(BOXES, FAMILY, seed=3)
    detector = open_detector(FAMILY, Path())
    labeller = Labeller(BOXES, FAMILY, PoseConfig())
    samples = []
    for i in range(count):
        rendered = scene.render(CAMERA, index=i * APART, depth=False)
        markers = detector.detect(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY))
        coarse = labeller.label(markers, CAMERA, "cam0", i * APART * FRAME_NS)
        refined = labeller.label(markers, CAMERA, "cam0", i * APART * FRAME_NS, rendered.bgr)
        bare = scene.render(CAMERA, index=i * APART, depth=False, markers=False)
        sticker = (rendered.bgr != bare.bgr).any(axis=2)
        samples.append(Sample(rendered.bgr, sticker, rendered.truth, coarse, refined))
    return samples


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return _samples(40)


def iou(one: Window, two: Window) -> float:
    width = min(one.x_max, two.x_max) - max(one.x_min, two.x_min)
    height = min(one.y_max, two.y_max) - max(one.y_min, two.y_min)
    if width <= 0 or height <= 0:
        return 0.0
    areas = [(w.x_max - w.x_min) * (w.y_max - w.y_min) for w in (one, two)]
    return width * height / (sum(areas) - width * height)


def pairs(samples: list[Sample], which: str) -> list[tuple[ObjectLabel, TrueObject]]:
    """Every labelled object that isn't marked as ambiguous, with its truth."""
    found = []
    for sample in samples:
        by_name = {label.name: label for label in getattr(sample, which).objects}
        found += [(by_name[t.name], t) for t in sample.truth if t.name in by_name]
    return [(label, truth) for label, truth in found if not label.quality.ambiguous]


def check(samples: list[Sample], which: str, least: float) -> None:
    together = pairs(samples, which)
    assert len(together) >= least * sum(len(sample.truth) for sample in samples)
    overlaps = np.array([iou(label.window_unclipped, truth.window) for label, truth in together])
    assert np.median(overlaps) >= 0.97
    assert (overlaps > 0.9).mean() >= 0.95
    errors = [abs(label.distance_mm / truth.distance_mm - 1) for label, truth in together]
    assert np.median(errors) < 0.01


def test_windows_and_distances_from_coarse_corners(samples):
    check(samples, "coarse", least=0.8)  # lone small markers stay ambiguous there


def test_windows_and_distances_from_refined_corners(samples):
    check(samples, "refined", least=0.98)
    corners = [
        np.linalg.norm(np.subtract([(c.x, c.y) for c in label.corners], truth.corners), axis=1).max()
        for label, truth in pairs(samples, "refined")
    ]
    assert np.median(corners) < 0.5
    errors = [abs(label.distance_mm / truth.distance_mm - 1) for label, truth in pairs(samples, "refined")]
    assert np.median(errors) < 0.001


def test_every_visible_marker_is_a_side_or_has_a_reason(samples):
    for sample in samples:
        told = {side.marker for label in sample.refined.objects for side in label.sides}
        told |= {entry.marker for entry in sample.refined.left_out}
        assert {marker.id for truth in sample.truth for marker in truth.markers if marker.visible} <= told


def test_no_pixel_of_a_marker_survives(samples):
    """Black square, border and softened edge of every visible marker are erased, also of undetected ones."""
    detector = open_detector(FAMILY, Path())
    for sample in samples[:15]:
        polygons = regions(sample.refined.objects, sample.refined.left_out, BOXES, CAMERA)
        mask = mask_of(polygons, WHOLE) > 0
        assert sample.sticker.sum() > 500
        assert not (sample.sticker & ~mask).any(), np.argwhere(sample.sticker & ~mask)[:5]
        picture = sample.bgr.copy()
        erase(picture, polygons)
        np.testing.assert_array_equal(picture[~mask], sample.bgr[~mask])
        assert detector.detect(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)) == []


@pytest.mark.long
def test_two_hundred_random_frames():
    samples = _samples(200)
    check(samples, "coarse", least=0.8)
    check(samples, "refined", least=0.98)
