from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.geometry import Pose
from services.label.continuity import HALF_LIFE_NS, LIFETIME_NS, LastPoses
from services.label.pose import CERTAIN, BoxPose, solve_box
from services.label.visible_objects import sort_markers
from tests.unit.services.label.truth import BOX, CAMERA, looking_at, seen

FRAME_NS = 33_000_000


def found(pose: Pose, evidence: float = CERTAIN) -> BoxPose:
    visible = sort_markers(seen(0, pose=looking_at(30, 20, 900)), [BOX]).objects[0]
    return replace(solve_box(BOX, visible.markers, CAMERA, 6.0), pose=pose, evidence=evidence)


POSE = looking_at(10, 10, 1000)


def test_nothing_is_known_at_first():
    assert LastPoses().prior("cam0", "box-1", 0) is None


def test_evidence_fades_and_ends():
    last = LastPoses()
    last.remember("cam0", "box-1", 0, found(POSE, 16.0))
    prior = last.prior("cam0", "box-1", HALF_LIFE_NS)
    assert prior is not None
    assert prior.evidence == pytest.approx(8.0)
    assert prior.pose is POSE
    assert last.prior("cam0", "box-1", LIFETIME_NS + 1) is None


def test_cameras_and_objects_are_kept_apart():
    last = LastPoses()
    last.remember("cam0", "box-1", 0, found(POSE))
    assert last.prior("cam1", "box-1", FRAME_NS) is None
    assert last.prior("cam0", "box-2", FRAME_NS) is None
    last.forget("cam1")
    assert last.prior("cam0", "box-1", FRAME_NS) is not None
    last.forget("cam0")
    assert last.prior("cam0", "box-1", FRAME_NS) is None


def test_a_frame_does_not_speak_for_itself():
    """It is labelled a second time when it is recorded; its own first label is no independent witness."""
    last = LastPoses()
    last.remember("cam0", "box-1", 0, found(POSE, 5.0))
    last.remember("cam0", "box-1", FRAME_NS, found(looking_at(20, 20, 1000), 25.0))
    last.remember("cam0", "box-1", FRAME_NS, found(looking_at(21, 20, 1000), 25.0))
    prior = last.prior("cam0", "box-1", FRAME_NS)
    assert prior is not None
    assert prior.pose is POSE


def test_a_late_frame_changes_nothing():
    last = LastPoses()
    last.remember("cam0", "box-1", 10 * FRAME_NS, found(POSE))
    last.remember("cam0", "box-1", 9 * FRAME_NS, found(looking_at(50, 0, 500)))
    prior = last.prior("cam0", "box-1", 11 * FRAME_NS)
    assert prior is not None
    assert prior.pose is POSE


def test_a_wrong_flip_does_not_perpetuate_itself():
    """Start from a mirrored pose believed in fully; weak but steady evidence of the frames must win."""
    true = looking_at(25, 18, 1100)
    visible = [sort_markers(seen(0, pose=true, noise=0.2, kind="subpix", seed=s), [BOX]).objects[0] for s in range(60)]
    lone = [solve_box(BOX, v.markers, CAMERA, 6.0) for v in visible]
    doubtful = next(f for f in lone if f.alternative is not None)
    wrong = max((doubtful.pose, doubtful.alternative), key=true.angle_to)
    assert wrong.angle_to(true) > np.radians(20)
    last = LastPoses()
    last.remember("cam0", "box-1", 0, found(wrong))
    poses = []
    for i, markers in enumerate(visible, start=1):
        now = i * FRAME_NS
        pose = solve_box(BOX, markers.markers, CAMERA, 6.0, last.prior("cam0", "box-1", now))
        last.remember("cam0", "box-1", now, pose)
        poses.append(pose)
    assert all(pose.pose.angle_to(true) < np.radians(12) for pose in poses[-20:])
    assert not any(pose.ambiguous for pose in poses[-20:])
