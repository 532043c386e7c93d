"""Visibility against the renderer's truth: a hand 100 mm before a box, depth noise of 1 %, on random views."""

from __future__ import annotations

import numpy as np

from common.geometry import FACES, Box, Pose
from common.scene import Scene
from common.scene.hand import Hand, noisy_depth
from services.label.occlusion import DepthPicture, look
from services.label.visibility import viewing_angle
from tests.replay.scenes import APART, BOXES, CAMERA, FAMILY

VIEWS = 10
FINE = 24


def hand_before(box: Box, pose: Pose, random: np.random.Generator) -> Hand:
    """A hand that reaches over a random corner or face point of the box, 100 mm nearer to the camera."""
    target = pose.apply(box.corners)[random.integers(8)] * 0.6 + pose.translation * 0.4
    z = pose.apply(box.corners)[:, 2].min() - 100.0
    turn = Pose.from_rvec([0, 0, random.uniform(0, 2 * np.pi)], np.zeros(3)).rotation @ np.diag([1.0, -1.0, -1.0])
    return Hand(Pose(turn, target * z / target[2]), size=1.3)


def true_share(box: Box, face, pose: Pose, hand: Hand, others) -> float:
    steps = (np.arange(FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(steps, steps)
    width, height, _ = box.face_size(face)
    flat = np.column_stack([x.ravel() * width, y.ravel() * height, np.zeros(x.size)])
    return float(true_visible(pose.apply(box.face_pose(face).apply(flat)), hand, others).mean())


def true_visible(xyz, hand: Hand, others) -> np.ndarray:
    pixels, front = CAMERA.project(xyz)
    seen = front & CAMERA.contains(pixels) & ~hand.covers(xyz)
    for box, pose in others:
        seen &= ~behind(xyz, box, pose)
    return seen


def behind(xyz, box: Box, pose: Pose) -> np.ndarray:
    """By marching along each sight line: slow, and shares nothing with the code under test."""
    width, height, depth = box.size_mm
    half = np.array([width, depth, height]) / 2
    inside = np.zeros(len(xyz), dtype=bool)
    for share in np.linspace(0.4, 0.995, 100):
        inside |= (np.abs(pose.inverse().apply(xyz * share)) < half).all(axis=1)
    return inside


def test_corners_and_sides_under_a_hand() -> None:
    scene = Scene(BOXES, FAMILY, seed=7)
    random = np.random.default_rng(1)
    corners, sides, covered = [], [], 0
    for number in range(VIEWS):
        poses = scene.poses(number * APART)
        rendered = scene.render(CAMERA, poses, index=number * APART, depth_noise_mm=0)
        hand = hand_before(BOXES[0], poses["box-1"], random)
        hand.draw(rendered.bgr, rendered.depth, CAMERA)
        depth = DepthPicture(noisy_depth(rendered.depth, 0.01, random), 1.0)
        for box in BOXES:
            pose = poses[box.name]
            others = [(other, poses[other.name]) for other in BOXES if other is not box]
            found = look(box, pose, CAMERA, others, depth)
            facing = [face for face in FACES if viewing_angle(pose, face, box.face_pose(face).translation) < 90]
            own = np.zeros(8, dtype=bool)
            for face in facing:
                own |= box.corners @ np.array(FACES[face].normal) > 0
            truth = own & true_visible(pose.apply(box.corners), hand, others)
            covered += int((own & ~truth).sum())
            corners += list(found.corners == truth)
            assert {item.face for item in found.faces} == set(facing)
            sides += [abs(found.share(face) - true_share(box, face, pose, hand, others)) < 0.1 for face in facing]
            without = look(box, pose, CAMERA, others)
            assert (without.corners >= found.corners).all()
    print(f"corners right {np.mean(corners):.3f}, sides right {np.mean(sides):.3f}, hidden corners {covered}")
    assert covered > 10  # the hand does hide something
    assert np.mean(corners) >= 0.95, np.mean(corners)
    assert np.mean(sides) >= 0.95, np.mean(sides)
