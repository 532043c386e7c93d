"""Everything that is measured on one sample, in a worker process."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.dataset import SessionReader
from common.geometry import Box, CameraModel, Pose, view_direction
from common.ids import sample_camera
from common.labels import Erased, Label, ObjectLabel, Window
from common.markers import Family, family
from common.quality.blur import blur
from common.quality.duplicates import perceptual_hash
from services.detect.markers import MarkerDetector, open_detector
from services.label.visibility import facing_side
from tools.inspect.consistency import contradictions, off_px, unknown_objects, window_array
from tools.inspect.facts import Facts, ObjectFacts, Problem
from tools.inspect.files import Opened, open_sample
from tools.inspect.outline import outline_support
from tools.inspect.surfaces import depth_difference, pattern_left

Grey = NDArray[np.uint8]

_DARK, _BRIGHT = 2, 253
_SAME = 12
"""Grey levels by which a pixel outside of the erased regions may differ from the original: a JPEG's."""
_GROWN_PX = 3


@dataclass(frozen=True)
class Job:
    """A session to look at. ``family``: the markers' name; None: only files are looked at, or nobody knows them."""

    folder: Path
    boxes: tuple[Box, ...]
    family: str | None
    pictures: bool = True


class Inspector:
    """What a worker keeps from sample to sample."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._reader = SessionReader(job.folder)
        self._boxes: Mapping[str, Box] = {box.name: box for box in job.boxes}
        known = job.family is not None and job.pictures
        self._family: Family | None = family(job.family or "", job.folder) if known else None
        self._detector: MarkerDetector | None = open_detector(self._family, job.folder) if self._family else None

    def look(self, sample: str) -> Facts:
        """All facts of one sample."""
        opened = open_sample(self._reader, sample)
        label = opened.label
        if label is None or "rgb" not in opened.pictures:
            return Facts(sample, sample_camera(sample), problems=tuple(opened.problems), bytes=opened.bytes)
        camera = CameraModel.from_label(label.camera)
        objects = tuple(self._object(item, label, camera, opened) for item in label.objects)
        opened.problems += _contradicting(label, objects)
        found: dict[str, Any] = self._of_picture(label, opened) if self._job.pictures else {}
        return Facts(
            sample,
            label.camera.name,
            problems=tuple(opened.problems),
            readable=True,
            recording=label.recording,
            wall_ns=label.captured_wall_ns,
            complete=label.complete,
            background=label.background,
            bytes=opened.bytes,
            objects=objects,
            **found,
        )

    def _of_picture(self, label: Label, opened: Opened) -> dict[str, Any]:
        bgr = np.asarray(opened.pictures["rgb"], dtype=np.uint8)
        grey = _grey(bgr)
        found: dict[str, Any] = {
            "blur": blur(grey),
            "brightness": float(grey.mean()),
            "clipped": float(((grey <= _DARK) | (grey >= _BRIGHT)).mean()),
            "alike": perceptual_hash(grey),
            "pixels": zlib.crc32(bgr.tobytes()),
        }
        if self._detector is not None:
            found["remains"] = tuple(sorted({marker.id for marker in self._detector.detect(grey)}))
        original = opened.pictures.get("original")
        if original is not None:
            was = np.asarray(original, dtype=np.uint8)
            found["original_px"] = self._moved(label, _grey(was))
            found["changed"] = _changed(bgr, was, label.inpainted)
        return found

    def _moved(self, label: Label, original: Grey) -> float | None:
        """Distance of an object's labelled marker corners from those that the original shows; None without any.

        The median of each object, and of those the largest.
        """
        if self._detector is None:
            return None
        there = {marker.id: np.array(marker.corners) for marker in self._detector.detect(original)}
        medians = []
        for item in label.objects:
            pairs = [
                np.linalg.norm(np.array(side.marker_corners) - there[side.marker], axis=1)
                for side in item.sides
                if side.marker in there
            ]
            if pairs:
                medians.append(float(np.median(np.concatenate(pairs))))
        return max(medians, default=None)

    def _object(self, item: ObjectLabel, label: Label, camera: CameraModel, opened: Opened) -> ObjectFacts:
        pose, box = Pose.from_label(item.pose), self._boxes.get(item.name)
        azimuth, elevation = view_direction(item.pose.matrix)
        sigma = item.quality.uncertainty
        corner_sigmas = [] if sigma is None else [value for value in sigma.corners_px if value is not None]
        found: dict[str, Any] = {"off_px": 0.0, "wrong": (unknown_objects(self._boxes, item),)}
        if box is not None:
            found = {
                "off_px": off_px(item, box, pose, camera),
                "wrong": tuple(contradictions(item, box, pose, camera)),
            }
        facing = None if box is None else facing_side(box, pose)
        return ObjectFacts(
            name=item.name,
            type=item.type,
            class_name="" if facing is None else facing[0],
            distance_mm=item.distance_mm,
            angle_deg=float("nan") if facing is None else facing[2],
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            window=window_array(item.window_unclipped),
            pose=pose.matrix,
            whole=item.window == item.window_unclipped,
            residual_px=item.quality.reprojection_error_px,
            corner_sigma_px=max(corner_sigmas, default=None),
            distance_sigma_mm=None if sigma is None else sigma.distance_mm,
            ambiguous=item.quality.ambiguous,
            erased=_erased_share(item.window, label.inpainted),
            **found,
            **self._in_picture(item, label, camera, opened),
        )

    def _in_picture(self, item: ObjectLabel, label: Label, camera: CameraModel, opened: Opened) -> dict[str, Any]:
        nothing = {"depth_mm": None, "depth_signed_mm": None, "outline": None, "pattern": 0.0, "pattern_marker": None}
        box = self._boxes.get(item.name)
        if box is None or not self._job.pictures:
            return nothing
        pose = Pose.from_label(item.pose)
        others = [
            (self._boxes[other.name], Pose.from_label(other.pose))
            for other in label.objects
            if other is not item and other.name in self._boxes
        ]
        grey = _grey(np.asarray(opened.pictures["rgb"], dtype=np.uint8))
        found = nothing | {"outline": outline_support(grey, box, pose, others, camera)}
        depth = opened.pictures.get("depth")
        if depth is not None and label.depth is not None:
            off = depth_difference(depth.astype(np.float64) * label.depth.unit_mm, box, pose, others, camera)
            if off is not None:
                found |= {"depth_mm": off[0], "depth_signed_mm": off[1]}
        if self._family is not None:
            value, marker = pattern_left(grey, box, pose, others, camera, self._family)
            found |= {"pattern": value, "pattern_marker": marker}
        return found


def _contradicting(label: Label, objects: tuple[ObjectFacts, ...]) -> list[Problem]:
    """What in a label can't be: for `--verify`; suspicion goes by the same facts."""
    from common.dataset import label_path
    from tools.inspect.consistency import OFF_LIMIT_PX

    path = str(label_path(label.sample))
    found = [text for item in objects for text in item.wrong]
    found += [
        f"{item.name}'s corners and windows are up to {item.off_px:.1f} px from where its own pose puts them"
        for item in objects
        if item.off_px > OFF_LIMIT_PX
    ]
    return [Problem("contradiction", label.sample, path, f"{path}: {text}") for text in found]


def _grey(bgr: NDArray[np.uint8]) -> Grey:
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _erased_share(window: Window | None, erased: Erased) -> float:
    """The share of the window's pixels that were erased."""
    if window is None:
        return 0.0
    low = np.floor([window.x_min + 0.5, window.y_min + 0.5]).astype(int)
    size = np.maximum(np.ceil([window.x_max + 0.5, window.y_max + 0.5]).astype(int) - low, 1)
    mask = _mask(erased, (int(size[1]), int(size[0])), low)
    return float(np.count_nonzero(mask)) / mask.size


def _mask(erased: Erased, size: tuple[int, int], low: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The erased regions in a part (H, W) of the picture that begins at ``low`` (x, y)."""
    mask = np.zeros(size, dtype=np.uint8)
    for region in erased.polygons:
        outline = np.rint(np.array(region.polygon) - low).astype(np.int32)
        if len(outline) > 2:
            cv2.fillPoly(mask, [outline], 255)
    return mask


def _changed(bgr: NDArray[np.uint8], original: NDArray[np.uint8], erased: Erased) -> float:
    mask = _mask(erased, bgr.shape[:2], np.zeros(2, dtype=np.int64))
    near = cv2.dilate(mask, np.ones((2 * _GROWN_PX + 1, 2 * _GROWN_PX + 1), dtype=np.uint8)) > 0
    differs = cv2.absdiff(bgr, original).max(axis=2) > _SAME
    outside = ~near
    return float((differs & outside).sum()) / max(int(outside.sum()), 1)
