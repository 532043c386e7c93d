"""The error bars of labels against the renderer's truth: the true error lies within two of them in 90 to 99 %.

Detector, refinement and pose as in production; frames are over a second apart, so that none helps the next.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config.models import PoseConfig
from common.geometry import Pose
from common.messages import TrueObject
from common.scene import Scene
from services.detect.markers import open_detector
from services.label.labelling import Labeller
from tests.replay.scenes import APART, BOXES, CAMERA, FAMILY, FRAME_NS

Errors = dict[str, list[float]]


def ratios(frames: int, seed: int) -> Errors:
    """True error by error bar, of each labelled object of the frames: distance, rotation, each corner."""
    scene = Scene(BOXES, FAMILY, seed=seed)
    detector = open_detector(FAMILY, Path())
    labeller = Labeller(BOXES, FAMILY, PoseConfig())
    found: Errors = {"distance": [], "rotation": [], "corners": []}
    for number in range(frames):
        index = number * APART
        noise, blur = (1.0, 2.0, 4.0)[number % 3], (0.5, 0.8)[number % 2]
        rendered = scene.render(CAMERA, index=index, depth=False, noise=noise, blur_px=blur)
        markers = detector.detect(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY))
        labels = labeller.label(markers, CAMERA, "cam0", index * FRAME_NS, rendered.bgr).objects
        truth = {item.name: item for item in rendered.truth}
        for label in labels:
            _compare(label, truth[label.name], found)
    return found


def _compare(label, truth: TrueObject, found: Errors) -> None:
    bar = label.quality.uncertainty
    true = Pose.from_rvec(truth.rvec, truth.tvec_mm)
    found["distance"].append(abs(label.distance_mm - truth.distance_mm) / bar.distance_mm)
    found["rotation"].append(np.degrees(Pose.from_label(label.pose).angle_to(true)) / bar.rotation_deg)
    off = np.linalg.norm(np.subtract([(c.x, c.y) for c in label.corners], truth.corners), axis=1)
    found["corners"] += list(off / np.array(bar.corners_px))


def check(found: Errors, low: float, high: float) -> None:
    inside = {what: float(np.mean(np.array(values) < 2.0)) for what, values in found.items()}
    assert all(low <= share <= high for share in inside.values()), inside


def test_the_true_error_lies_within_two_bars() -> None:
    found = ratios(30, seed=3)
    assert len(found["distance"]) >= 57
    check(found, 0.90, 1.0)  # sixty objects are too few for an upper limit of 99 %
    # Bars that are far too wide would pass that; half of all errors must reach a third of their bar.
    medians = {what: float(np.median(values)) for what, values in found.items()}
    assert all(median > 0.33 for median in medians.values()), medians


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_true_error_of_five_hundred_frames_lies_within_two_bars() -> None:
    found = {"distance": [], "rotation": [], "corners": []}
    for seed in range(4):
        for what, values in ratios(125, seed=10 + seed).items():
            found[what] += values
    assert len(found["distance"]) >= 950
    check(found, 0.90, 0.99)
