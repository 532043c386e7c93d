"""Checking an export: what is on the disk, read back from it alone, against the label files it came from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import DatasetError
from common.geometry import CameraModel
from tools.export.formats.parts import as_array
from tools.export.loaders import LOADERS, Absent
from tools.export.manifest import Manifest
from tools.export.masks import covering
from tools.export.model import Export, Exporter, ReadTarget, Shot, Target

Array = NDArray[np.float64]
LIMIT_PX = 0.5
_JPEG_END = b"\xff\xd9"


@dataclass
class Checks:
    """``done``: what was looked at and found right; ``failed``: what is wrong; ``absent``: what wasn't looked at."""

    done: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)


def check_export(
    folder: Path, name: str, exporter: Exporter, export: Export, tick: Callable[[], None] = lambda: None
) -> Checks:
    """Run every check there is for a format; ``tick`` after each."""
    found = Checks()
    for look in (_files, _reprojection):
        look(folder, exporter, export, found)
        tick()
    for loader in LOADERS.get(name, ()):
        try:
            found.done.append(loader(folder, export))
        except Absent as error:
            found.absent.append(str(error))
        except DatasetError as error:
            found.failed.append(error.message)
        tick()
    if name not in LOADERS:
        found.absent.append(f"no official loader is known for {name}")
    return found


def _files(folder: Path, _: Exporter, __: Export, found: Checks) -> None:
    """Every file is there and as large as it was written; a JPEG ends as one."""
    manifest = Manifest.read(folder)
    if manifest is None or not manifest.complete:
        found.failed.append(f"{folder} holds no complete export")
        return
    wrong = []
    for path, (_key, size) in manifest.files.items():
        try:
            there = (folder / path).stat().st_size
        except OSError:
            there = -1
        if there != size or (path.endswith(".jpg") and not (folder / path).read_bytes().endswith(_JPEG_END)):
            wrong.append(path)
    if wrong:
        found.failed.append(
            f"{len(wrong)} of {len(manifest.files)} files are missing or changed, the first is {wrong[0]}"
        )
    else:
        found.done.append(f"{len(manifest.files)} files are there")


def _reprojection(folder: Path, exporter: Exporter, export: Export, found: Checks) -> None:
    """Corners, windows and outlines as read back lie where the label files put them."""
    worst, mean, count = 0.0, 0.0, 0
    where = ""
    limit = LIMIT_PX + exporter.traits.rounding_px
    try:
        for shot, targets in exporter.read(folder, export):
            for distance in _compare(shot, targets):
                count, mean = count + 1, mean + distance
                if distance > worst:
                    worst, where = distance, shot.stem
    except DatasetError as error:
        found.failed.append(error.message)
        return
    found.figures["reprojection"] = {"targets": count, "worst_px": worst, "mean_px": mean / max(count, 1)}
    told = f"{count} targets against the label files: at most {worst:.3f} px off, {mean / max(count, 1):.3f} on average"
    if exporter.traits.lossy:
        found.done.append(f"{told} (the format can't hold the whole pose)")
    elif worst > limit:
        found.failed.append(f"{told}, in {where}; more than {limit:g} px is wrong")
    else:
        found.done.append(told)


def _compare(shot: Shot, read: list[ReadTarget]) -> list[float]:
    """How far off (px) each target is; raises DatasetError if there are others than there should be."""
    names = [target.class_name for target in read]
    wanted = [target.class_name for target in shot.targets]
    if names != wanted:
        raise DatasetError(f"{shot.stem} was read back with {names} instead of {wanted}")
    return [
        _distance(shot, target, one, bool(before))
        for target, one, before in zip(shot.targets, read, covering(shot), strict=True)
    ]


def _distance(shot: Shot, target: Target, read: ReadTarget, covered: bool) -> float:
    expected = expected_corners(shot, target)
    off = [0.0]
    if read.points is not None:
        both = np.isfinite(read.points).all(axis=1) & np.isfinite(expected).all(axis=1)
        off += np.linalg.norm(read.points[both] - expected[both], axis=1).tolist()
        lacking = [i for i, state in enumerate(target.states) if state and not np.isfinite(read.points[i]).all()]
        if lacking:
            raise DatasetError(f"{shot.stem}: a corner that is in the picture was not read back")
    if target.is_side:
        if read.window is not None:
            off.append(float(np.abs(read.window - as_array(target.window)).max()))
        return max(off)
    if read.window is not None and np.isfinite(expected).all():
        off.append(float(np.abs(read.window - _window(expected, shot.camera)).max()))
    if read.outline is not None and not covered:
        outline = read.outline.astype(np.float32).reshape(-1, 1, 2)
        inside = expected[np.isfinite(expected).all(axis=1) & shot.camera.contains(expected)]
        off += [max(0.0, -cv2.pointPolygonTest(outline, (float(x), float(y)), True)) for x, y in inside]
    return max(off)


def expected_corners(shot: Shot, target: Target) -> Array:
    """The label file's corners (8, 2) in the exported picture; NaN where it has none."""
    stored = np.array(
        [
            (np.nan, np.nan) if corner.x is None or corner.y is None else (corner.x, corner.y)
            for corner in target.item.corners
        ]
    )
    if not shot.change.undistort:
        return shot.change.pixels(stored)
    known = np.isfinite(stored).all(axis=1)
    expected = np.full_like(stored, np.nan)
    rays = CameraModel.from_label(shot.source.label.camera).normalise(stored[known])
    expected[known] = rays @ shot.camera.matrix[:2, :2].T + shot.camera.matrix[:2, 2]
    return expected


def _window(corners: Array, camera: CameraModel) -> Array:
    low, high = corners.min(axis=0), corners.max(axis=0)
    limit = np.array([camera.width, camera.height]) - 0.5
    return np.concatenate([np.maximum(low, -0.5), np.minimum(high, limit)])
