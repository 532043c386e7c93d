"""KITTI object 3D: ``training/{image_2,label_2,calib}``, undistorted PNG pictures, parts in ``ImageSets``.

A KITTI box stands upright: only its turn about the camera's vertical axis is stored. Roll and pitch are lost, and how
much that is for these samples is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from common.errors import DatasetError
from common.geometry import Box, Pose
from tools.export.formats.parts import Array, as_array, picture_file, read_text
from tools.export.model import Export, OutFile, ReadTarget, Shot, Target, Traits, Written, text_file

_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Columns: KITTI's object axes (length, down, width) in tagmill's object frame (X right, Y away, Z up)."""
_EDGES_OF_OCCLUSION = (0.8, 0.4)
_FIELDS = 15


class Kitti:
    """KITTI's label files."""

    traits: ClassVar[Traits] = Traits(
        default_classes="type", whole=True, undistorted=True, pictures=("png",), lossy=True, rounding_px=0.01
    )

    def shot(self, shot: Shot, export: Export) -> Written:
        """Picture, label, calibration."""
        name = f"{shot.number:06d}"
        rows = "".join(f"{_row(target)}\n" for target in shot.targets)
        return Written(
            (
                picture_file(shot, f"training/image_2/{name}.png"),
                text_file(f"training/label_2/{name}.txt", rows),
                text_file(f"training/calib/{name}.txt", _calibration(shot)),
            )
        )

    def index(self, export: Export, told: Sequence[Any]) -> list[OutFile]:
        """Which pictures are for training and which for validation; the sample behind each number."""
        files = [
            text_file(f"ImageSets/{part}.txt", "".join(f"{shot.number:06d}\n" for shot in export.of(part)))
            for part in export.splits
        ]
        return [*files, text_file("samples.txt", "".join(f"{shot.number:06d} {shot.stem}\n" for shot in export.shots))]

    def read(self, folder: Path, export: Export) -> Iterator[tuple[Shot, list[ReadTarget]]]:
        """The 2D windows, and the corners of the upright boxes projected by P2."""
        known = {kitti_name(name): name for name in export.classes}
        for shot in export.shots:
            name = f"{shot.number:06d}.txt"
            calibration = read_text(folder / "training" / "calib" / name).splitlines()
            matrix = np.array(
                next(line.split()[1:] for line in calibration if line.startswith("P2:")), dtype=np.float64
            )
            found = []
            for line in read_text(folder / "training" / "label_2" / name).splitlines():
                fields = line.split(" ")
                if len(fields) != _FIELDS:
                    raise DatasetError(f"{name}: '{line}' has {len(fields)} fields instead of {_FIELDS}")
                numbers = np.array(fields[1:], dtype=np.float64)
                points = _corners(numbers) @ matrix.reshape(3, 4)[:, :3].T
                points = points[:, :2] / points[:, 2:]
                found.append(ReadTarget(known[fields[0]], window=numbers[3:7], points=points))
            yield shot, found

    def notes(self, export: Export) -> list[str]:
        """How much of the poses is lost."""
        tilts = [tilt_deg(target.pose) for shot in export.shots for target in shot.targets]
        lean = f"{np.median(tilts):.1f} degrees (median), {max(tilts):.1f} at most"
        notes = [
            f"KITTI stores no roll and pitch: the boxes lean against the camera's vertical by {lean}; that is lost"
        ]
        renamed = [name for name in export.classes if kitti_name(name) != name]
        notes += [
            f"'{name}' is written as '{kitti_name(name)}': KITTI's fields are parted by spaces" for name in renamed
        ]
        return notes


def kitti_name(name: str) -> str:
    """A class name without spaces."""
    return "_".join(name.split())


def tilt_deg(pose: Pose) -> float:
    """Between the box's upright axis and the camera's vertical one."""
    return float(np.degrees(np.arccos(np.clip((pose.rotation @ _AXES)[1, 1], -1.0, 1.0))))


def _row(target: Target) -> str:
    width, height, depth = target.box.size_mm
    rotation = target.pose.rotation @ _AXES
    yaw = float(np.arctan2(rotation[0, 2] - rotation[2, 0], rotation[0, 0] + rotation[2, 2]))
    # From the centre straight down, not along the tilted box: so the box's centre stays right.
    x, y, z = (target.pose.translation + np.array([0.0, height / 2, 0.0])) / 1000
    alpha = _wrapped(yaw - float(np.arctan2(x, z)))
    truncated = 1 - _area(as_array(target.window)) / max(_area(as_array(target.window_unclipped)), 1e-9)
    window = " ".join(f"{value:.2f}" for value in as_array(target.window))
    sizes = " ".join(f"{value / 1000:.4f}" for value in (height, depth, width))
    where = " ".join(f"{value:.4f}" for value in (x, y, z))
    name = kitti_name(target.class_name)
    return f"{name} {truncated:.2f} {_occluded(target)} {alpha:.4f} {window} {sizes} {where} {yaw:.4f}"


def _occluded(target: Target) -> int:
    """0 visible, 1 partly hidden, 2 largely, 3 unknown: by the best seen side's visible share."""
    shares = [face.visible_share for face in target.item.faces]
    if not shares:
        return 3
    return sum(max(shares) < edge for edge in _EDGES_OF_OCCLUSION)


def _calibration(shot: Shot) -> str:
    projection = np.column_stack([shot.camera.matrix, np.zeros(3)])
    same = np.eye(3)
    still = np.column_stack([np.eye(3), np.zeros(3)])
    rows = [(f"P{number}", projection) for number in range(4)]
    rows += [("R0_rect", same), ("Tr_velo_to_cam", still), ("Tr_imu_to_velo", still)]
    return "".join(f"{name}: {' '.join(f'{value:.9e}' for value in numbers.ravel())}\n" for name, numbers in rows)


def _corners(numbers: Array) -> Array:
    """The corners (8, 3) in metres, camera frame, of a row's numbers (14,), in tagmill's order."""
    height, depth, width = numbers[7:10]
    yaw = numbers[13]
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    box = Box("", "", (width, height, depth), ())
    return np.asarray(box.corners @ _AXES @ turn.T + numbers[10:13] - np.array([0.0, height / 2, 0.0]))


def _area(window: Array) -> float:
    return float((window[2] - window[0]) * (window[3] - window[1]))


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
