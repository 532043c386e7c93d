"""Distances of rendered markers: the paper's set-up at nine distances, and two markers that share a side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from common.geometry import Box, BoxSide, MarkerOnSide, Pose
from common.labels import ObjectLabel
from common.markers import family
from tools.evaluate.chain import UPRIGHT, Chain, Studio, camera_of
from tools.evaluate.spread import Spread, spread

REAL_MM = tuple(float(mm) for mm in range(200, 1001, 100))
FAR_MM = 1000.0
WIDTH, HEIGHT, FOCAL_PX = 1280, 720, 921.6
MARKER_MM, BORDER_MM = 50.0, 10.0
TILT_DEG, APART_MM = 20.0, 200.0
FRAMES_A_PLACE = 10
"""So many frames are taken before the object is put elsewhere within half a pixel."""

ONE = Box("box", "box", (100.0, 100.0, 100.0), (BoxSide("front", "front", (MarkerOnSide(0, MARKER_MM, BORDER_MM),)),))
TWO = Box(
    "box",
    "box",
    (400.0, 300.0, 300.0),
    (
        BoxSide(
            "front",
            "front",
            (
                MarkerOnSide(0, MARKER_MM, BORDER_MM, (-APART_MM / 2, 0.0, 0.0)),
                MarkerOnSide(1, MARKER_MM, BORDER_MM, (APART_MM / 2, 0.0, 0.0)),
            ),
        ),
    ),
)


@dataclass(frozen=True)
class Joint:
    """Two markers on one side, 200 mm apart, the side tilted by 20 degrees, its middle at 1000 mm.

    Each marker from its own corners alone; the same from the joint pose; the box's centre from the joint pose.
    """

    own: Spread
    marker: Spread
    object: Spread


def table_2(seed: int, frames: int, done: Callable[[], None]) -> Iterator[Spread]:
    """One row a distance: a marker squarely before the camera; ``done`` is called after each frame."""
    studio, chain = _set_up(ONE, seed)
    for real in REAL_MM:
        random = np.random.default_rng([seed, int(real)])
        errors: list[float] = []
        for _, labels in _frames(studio, chain, ONE, partial(_facing, real, random), frames, random, done):
            errors += [side.distance_mm - real for label in labels for side in label.sides]
        yield spread(real, errors, frames)


def joint(seed: int, frames: int, done: Callable[[], None]) -> Joint:
    """The two-marker row; ``done`` is called after each frame."""
    studio, chain = _set_up(TWO, seed)
    random = np.random.default_rng([seed, 2])
    own: list[float] = []
    shared: list[float] = []
    centre: list[float] = []
    true = {marker.id: TWO.marker_pose(side, marker).translation for side in TWO.sides for marker in side.markers}
    for pose, labels in _frames(studio, chain, TWO, partial(_tilted, random), frames, random, done):
        for label in labels:
            centre.append(label.distance_mm - float(np.linalg.norm(pose.translation)))
            for side in label.sides:
                real = float(np.linalg.norm(pose.apply(true[side.marker])))
                own.append(side.distance_mm - real)
                shared.append(side.distance_joint_mm - real)
    return Joint(spread(FAR_MM, own, 2 * frames), spread(FAR_MM, shared, 2 * frames), spread(FAR_MM, centre, frames))


def _set_up(box: Box, seed: int) -> tuple[Studio, Chain]:
    markers = family("apriltag_36h11", Path())
    camera = camera_of(WIDTH, HEIGHT, FOCAL_PX)
    return Studio((box,), markers, camera, seed), Chain((box,), markers, camera)


def _frames(
    studio: Studio,
    chain: Chain,
    box: Box,
    place: Callable[[], Pose],
    frames: int,
    random: np.random.Generator,
    done: Callable[[], None],
) -> Iterator[tuple[Pose, tuple[ObjectLabel, ...]]]:
    """Each frame's pose and labels; the noise is another in each, the place in each tenth."""
    pose, shot = Pose.identity(), None
    for number in range(frames):
        if shot is None or number % FRAMES_A_PLACE == 0:
            pose = place()
            shot = studio.shot(0, {box.name: pose})
        labels = chain.label(shot.noisy(random))
        done()
        yield pose, labels


def _facing(real_mm: float, random: np.random.Generator) -> Pose:
    """The marker's centre at a distance, in the picture's middle to half a pixel, turned squarely to the camera."""
    pixels = random.uniform(-0.5, 0.5, 2)
    ray = np.array([*(pixels / FOCAL_PX), 1.0])
    centre = ray / np.linalg.norm(ray) * real_mm
    return Pose(UPRIGHT, centre + np.array([0.0, 0.0, ONE.size_mm[2] / 2]))


def _tilted(random: np.random.Generator) -> Pose:
    """The side's middle at ``FAR_MM`` in the picture's middle, tilted about a random axis of the side's plane."""
    about = random.uniform(0, 2 * np.pi)
    turn, _ = cv2.Rodrigues(np.radians(TILT_DEG) * np.array([np.cos(about), np.sin(about), 0.0]))
    rotation = np.asarray(turn, dtype=np.float64) @ UPRIGHT
    pixels = random.uniform(-0.5, 0.5, 2)
    ray = np.array([*(pixels / FOCAL_PX), 1.0])
    side_middle = rotation @ np.array([0.0, -TWO.size_mm[2] / 2, 0.0])
    return Pose(rotation, ray / np.linalg.norm(ray) * FAR_MM - side_middle)
