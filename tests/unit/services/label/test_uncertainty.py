"""Error bars of poses from corners of known noise. ``truth`` made the corners by cv2 alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.geometry import Pose
from services.label.pose import BoxPose, solve_box
from services.label.uncertainty import uncertainty
from services.label.visible_objects import sort_markers
from tests.unit.services.label.truth import BOX, BOX_CORNERS, CAMERA, FISHEYE, looking_at, project, seen


def solve(pose: Pose, noise: float, *ids: int, seed: int = 0, camera=CAMERA) -> BoxPose:
    markers = sort_markers(seen(*ids, pose=pose, model=camera, noise=noise, seed=seed), [BOX]).objects[0].markers
    known = [replace(marker, covariance=np.eye(8) * noise**2) for marker in markers]
    return solve_box(BOX, known, camera, 6.0)


@pytest.mark.parametrize(
    ("largest_tilt", "noise", "camera"), [(3, 0.02, CAMERA), (20, 0.05, CAMERA), (40, 0.1, CAMERA), (20, 0.05, FISHEYE)]
)
def test_a_lone_markers_errors_lie_within_two_bars_squarely_seen_or_not(largest_tilt, noise, camera):
    random = np.random.default_rng(1)
    ratios = []
    for seed in range(120):
        about, tilt = random.uniform(0, 2 * np.pi), random.uniform(0, largest_tilt)
        true = looking_at(tilt * np.cos(about), tilt * np.sin(about), 1000)
        found = solve(true, noise, 0, seed=seed, camera=camera)
        bar = uncertainty(BOX, found, camera)
        off = np.linalg.norm(
            project(BOX_CORNERS, found.pose, camera) - project(BOX_CORNERS, true, camera), axis=1
        ) / np.array(bar.corners_px)
        distance = abs(np.linalg.norm(found.pose.translation) - 1000) / bar.distance_mm
        ratios.append((distance, np.degrees(found.pose.angle_to(true)) / bar.rotation_deg, *off))
    inside = np.mean(np.array(ratios) < 2.0, axis=0)
    assert min(inside[0], inside[1], inside[2:].mean()) > 0.9, inside
    assert np.sqrt(np.mean(np.square(ratios))) > 0.7  # and the bars aren't wide for safety's sake


def test_a_marker_seen_squarely_has_a_wide_rotation_bar_where_a_tilted_one_has_a_narrow_one():
    square = uncertainty(BOX, solve(looking_at(0.5, 0, 1000), 0.05, 0), CAMERA)
    tilted = uncertainty(BOX, solve(looking_at(40, 0, 1000), 0.05, 0), CAMERA)
    joint = uncertainty(BOX, solve(looking_at(40, 25, 1000), 0.05, 0, 1, 2), CAMERA)
    assert square.rotation_deg > 4 * tilted.rotation_deg > 4 * joint.rotation_deg
    assert square.distance_mm < 3  # the distance hardly suffers


def test_where_nothing_decides_the_bar_spans_both_poses():
    told = [found for seed in range(40) if (found := solve(looking_at(12, 8, 1500), 0.3, 0, seed=seed)).ambiguous]
    assert len(told) > 5
    for found in told:
        bar = uncertainty(BOX, found, CAMERA)
        assert found.alternative is not None
        apart = np.linalg.norm(
            project(BOX_CORNERS, found.pose) - project(BOX_CORNERS, found.alternative), axis=1
        ) / np.array(bar.corners_px)
        assert (apart <= 2.05).all()
        assert np.degrees(found.pose.angle_to(found.alternative)) <= 2.05 * bar.rotation_deg


@pytest.mark.parametrize("wrong", [0, 1, 2])
@pytest.mark.parametrize("ids", [(0, 1), (0, 2), (0, 1, 2)])
def test_the_bar_of_markers_that_disagree_covers_whichever_is_wrong(ids, wrong):
    """One of them is off as a whole, by less than is tolerated: its own corners don't show it, the others' do."""
    true, random = looking_at(35, 25, 900), np.random.default_rng(wrong)
    seen_ = sort_markers(seen(*ids, pose=true, noise=0.02, seed=wrong), [BOX]).objects[0].markers
    for shift in random.uniform(-1.5, 1.5, (5, 2)):
        markers = [replace(one, covariance=np.eye(8) * 0.02**2) for one in seen_]
        if wrong < len(markers):
            off = markers[wrong].corners + shift
            corners = tuple((float(x), float(y)) for x, y in off)
            markers[wrong] = replace(markers[wrong], seen=markers[wrong].seen.model_copy(update={"corners": corners}))
        found = solve_box(BOX, markers, CAMERA, 6.0)
        bar = uncertainty(BOX, found, CAMERA)
        assert np.degrees(found.pose.angle_to(true)) < 4 * bar.rotation_deg
        assert abs(np.linalg.norm(found.pose.translation) - 900) < 4 * bar.distance_mm


def test_corners_behind_the_camera_have_no_bar():
    near = looking_at(0, 0, 240)
    inside = looking_at(89, 0, 190, (0, 0))
    for pose in (near, inside):
        found = replace(solve(looking_at(30, 20, 900), 0.05, 0, 1), pose=pose)
        bar = uncertainty(BOX, found, CAMERA)
        front = pose.apply(BOX.corners)[:, 2] > 1.0
        assert [value is not None for value in bar.corners_px] == list(front)
