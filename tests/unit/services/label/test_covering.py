"""A hand before a marker is kept, and no marker is left beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config.models import PoseConfig
from common.geometry import Pose
from common.markers import family
from common.scene import Scene, SceneCamera
from common.scene.hand import Hand, noisy_depth
from services.detect.markers import open_detector
from services.label.covering import covering
from services.label.inpaint import Crop, erase, mask_of
from services.label.labelling import Labeller
from services.label.occlusion import DepthPicture
from services.label.regions import regions_on_sides
from tests.unit.services.label.truth import BOX, CAMERA, looking_at

FAMILY = family("apriltag_36h11", Path())
POSE = looking_at(25, 20, 700)
WHOLE = Crop(0, 0, 1280, 720)


@pytest.fixture(scope="module")
def scene():
    return SceneCamera(Scene([BOX], FAMILY, 5), CAMERA)


@pytest.fixture(scope="module")
def covered(scene):
    """The front's marker behind three fingers, 100 mm before it: with and without markers, depth at 1 % noise."""
    seen, bare = (scene.render(0, {BOX.name: POSE}, markers=markers) for markers in (True, False))
    side, marker = BOX.markers()[0]
    centre = POSE.apply(BOX.marker_pose(side, marker).translation)[0]
    before = seen.depth.copy()
    hand = Hand(Pose(np.diag([1.0, -1, -1]), centre * (1 - 100 / np.linalg.norm(centre)) + [25, 75, 0]))
    hand.draw(seen.bgr, seen.depth, CAMERA)
    hand.draw(bare.bgr, None, CAMERA)
    depth = noisy_depth(seen.depth, 0.01, np.random.default_rng(1))
    return seen.bgr, bare.bgr, depth, seen.depth != before


@pytest.fixture(scope="module")
def found(covered):
    bgr = covered[0]
    markers = open_detector(FAMILY, Path()).detect(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))
    assert 0 not in {marker.id for marker in markers}
    labelled = Labeller((BOX,), FAMILY, PoseConfig(ambiguous="keep")).label_once(markers, CAMERA, bgr)
    return regions_on_sides(labelled.objects, labelled.left_out, (BOX,), CAMERA)


def test_the_hand_is_kept_and_no_marker_is_left(covered, found):
    bgr, bare, depth, hand = covered
    cover = covering(found, DepthPicture(depth, 1.0))
    mask = mask_of([region.polygon for region in found], WHOLE) > 0
    assert (cover.keep & ~hand).sum() == 0
    assert cover.keep.sum() > 0.75 * (hand & mask).sum()
    left = (bgr != bare).any(axis=2) & ~(mask & ~cover.keep)
    assert left.sum() == 0


@pytest.mark.parametrize("method", ["plane", "telea"])
def test_what_is_kept_is_not_touched_and_feeds_nothing(covered, found, method):
    bgr, bare, depth, _ = covered
    cover = covering(found, DepthPicture(depth, 1.0))
    filled = bgr.copy()
    erase(filled, found, method, covered=cover)
    np.testing.assert_array_equal(filled[cover.keep], bgr[cover.keep])
    open_ = (mask_of([region.polygon for region in found], WHOLE) > 0) & ~cover.near
    # Skin is redder than any board of the scene.
    redness = (filled[..., 2].astype(int) - filled[..., 0])[open_]
    assert abs(redness.mean() - (bare[..., 2].astype(int) - bare[..., 0])[open_].mean()) < 6


def test_nothing_is_kept_where_nothing_covers(scene, found):
    depth = scene.render(0, {BOX.name: POSE}).depth
    assert covering(found, DepthPicture(noisy_depth(depth, 0.01, np.random.default_rng(2)), 1.0)) is None


def test_holes_in_the_depth_cover_nothing(covered, found):
    assert covering(found, DepthPicture(np.zeros_like(covered[2]), 1.0)) is None


def test_the_unit_of_the_depth_counts(covered, found):
    fine, whole = DepthPicture(covered[2] * np.uint16(4), 0.25), DepthPicture(covered[2], 1.0)
    np.testing.assert_array_equal(covering(found, fine).keep, covering(found, whole).keep)
