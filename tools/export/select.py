"""Which samples go into the export, and why each of the others doesn't."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from common.dataset import SessionReader
from common.errors import RefusedError
from common.geometry import CameraModel
from common.labels import ObjectLabel
from common.quality import blur
from services.label.visibility import facing_side
from services.label.windows import clip_window
from tools.export.model import Source
from tools.export.options import Filters

_MIN_PATCH = 16
"""Pixels of a window's side below which its blur can't be judged."""
WORDS = {
    "camera": "of another camera",
    "object": "without a chosen object",
    "incomplete": "incomplete: an object in view has no pose (--incomplete takes them)",
    "ambiguous": "ambiguous pose (--ambiguous takes them)",
    "background": "without any object (--no-background)",
    "uncertainty": "corners not known well enough",
    "reprojection": "reprojection error too large",
    "angle": "seen too obliquely",
    "inside": "cut off by the picture's edge",
    "blur": "blurred",
    "distance": "too near or too far",
}


class Selected:
    """``kept`` samples, and how many were left out, by reason."""

    def __init__(self, kept: Sequence[Source], left_out: Counter[str]) -> None:
        self.kept = list(kept)
        self.left_out = left_out


def select(sources: Sequence[Source], filters: Filters, workers: int) -> Selected:
    """Apply the filters; raises RefusedError for a camera or object that no sample has, or if nothing is left.

    One of a sample's objects beyond a limit costs the sample: an object in the picture without a label would teach
    a detector not to see it.
    """
    _known("camera", filters.cameras, {source.label.camera.name for source in sources})
    _known("object", filters.objects, {name for source in sources for name in source.boxes})
    reasons = [_reason(source, filters) for source in sources]
    if filters.max_blur is not None:
        left = [index for index, reason in enumerate(reasons) if reason is None]
        limit = filters.max_blur

        def judge(index: int) -> str | None:
            return "blur" if _blur_of(sources[index], filters) > limit else None

        with ThreadPoolExecutor(workers) as pool:
            for index, reason in zip(left, pool.map(judge, left), strict=True):
                reasons[index] = reason
    counts = Counter(reason for reason in reasons if reason is not None)
    kept = [source for source, reason in zip(sources, reasons, strict=True) if reason is None]
    if not kept:
        told = "; ".join(f"{count} {WORDS[reason]}" for reason, count in counts.most_common())
        raise RefusedError(f"none of {len(sources)} samples is left: {told}", code="no_sample")
    return Selected(kept, counts)


def _known(what: str, names: Iterable[str], known: set[str]) -> None:
    for name in names:
        if name not in known:
            raise RefusedError(
                f"the sessions have no {what} '{name}'; they have {', '.join(sorted(known)) or 'none'}", code="refused"
            )


def _reason(source: Source, filters: Filters) -> str | None:
    label = source.label
    objects = [item for item in label.objects if not filters.objects or item.name in filters.objects]
    rules: list[tuple[str, Callable[[], bool]]] = [
        ("camera", lambda: bool(filters.cameras) and label.camera.name not in filters.cameras),
        ("incomplete", lambda: not label.complete and not filters.incomplete),
        ("background", lambda: not label.objects and not filters.background),
        ("object", lambda: bool(filters.objects) and bool(label.objects) and not objects),
        ("ambiguous", lambda: not filters.ambiguous and any(item.quality.ambiguous for item in objects)),
        ("uncertainty", lambda: any(_above(_uncertainty(item), filters.max_uncertainty_px) for item in objects)),
        (
            "reprojection",
            lambda: any(_above(item.quality.reprojection_error_px, filters.max_reprojection_px) for item in objects),
        ),
        (
            "angle",
            lambda: (
                filters.max_angle_deg is not None
                and any(_angle(source, item) > filters.max_angle_deg for item in objects)
            ),
        ),
        ("inside", lambda: filters.min_inside is not None and any(_inside(i) < filters.min_inside for i in objects)),
        (
            "distance",
            lambda: any(
                _above(item.distance_mm, filters.max_distance_mm)
                or (filters.min_distance_mm is not None and item.distance_mm < filters.min_distance_mm)
                for item in objects
            ),
        ),
    ]
    return next((name for name, applies in rules if applies()), None)


def _above(value: float, limit: float | None) -> bool:
    return limit is not None and value > limit


def _uncertainty(item: ObjectLabel) -> float:
    """Of the corners in the picture, the worst (px); infinite where the label has none."""
    bar = item.quality.uncertainty
    if bar is None:
        return float("inf")
    pairs = zip(item.corners, bar.corners_px, strict=False)
    return max((px for corner, px in pairs if corner.in_image and px is not None), default=0.0)


def _angle(source: Source, item: ObjectLabel) -> float:
    facing = facing_side(source.boxes[item.name], source.poses[item.name])
    return 90.0 if facing is None else facing[2]


def _inside(item: ObjectLabel) -> float:
    """Share of the window that is inside of the picture."""
    whole, cut = item.window_unclipped, item.window
    area = (whole.x_max - whole.x_min) * (whole.y_max - whole.y_min)
    return 0.0 if cut is None or area <= 0 else (cut.x_max - cut.x_min) * (cut.y_max - cut.y_min) / area


def _blur_of(source: Source, filters: Filters) -> float:
    """The worst of the objects' windows; of the whole picture where there is none."""
    grey = cv2.cvtColor(SessionReader(source.folder).colour(source.label), cv2.COLOR_BGR2GRAY)
    camera = CameraModel.from_label(source.label.camera)
    worst: float | None = None
    for item in source.label.objects:
        if filters.objects and item.name not in filters.objects:
            continue
        window = clip_window(item.window_unclipped, camera)
        if window is None:
            continue
        rows = slice(max(round(window.y_min), 0), round(window.y_max) + 1)
        columns = slice(max(round(window.x_min), 0), round(window.x_max) + 1)
        patch = np.asarray(grey[rows, columns], dtype=np.uint8)
        if min(patch.shape) >= _MIN_PATCH:
            worst = max(worst or 0.0, blur(patch))
    return blur(np.asarray(grey, dtype=np.uint8)) if worst is None else worst
