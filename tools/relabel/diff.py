"""What moved between a session and the one that was made of it again, and by how much."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from common.dataset import SessionReader
from common.geometry import Pose
from common.labels import Label, ObjectLabel

MEASURES = {
    "corners_px": ("corner", "px"),
    "window_px": ("window", "px"),
    "position_mm": ("position", "mm"),
    "rotation_deg": ("rotation", "°"),
    "distance_mm": ("distance", "mm"),
}
"""What is measured, with words and unit: the largest shift of a corner and of a side of the window in the picture, that
of the pose, and the distance's change, with its sign."""


@dataclass
class Moved:
    """One object (by name) over all samples: each measure's values, and which samples they are of."""

    samples: list[str] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MEASURES})

    def summary(self) -> dict[str, Any]:
        """Median, 95th percentile and largest (of its size) of each measure, and the sample of the largest."""
        found: dict[str, Any] = {"samples": len(self.samples)}
        for name, values in self.values.items():
            sizes = np.abs(values)
            known = np.flatnonzero(np.isfinite(sizes))
            if known.size:
                worst = int(known[np.argmax(sizes[known])])
                found[name] = {
                    "median": round(float(np.median(np.array(values)[known])), 4),
                    "p95": round(float(np.percentile(sizes[known], 95)), 4),
                    "largest": round(values[worst], 4),
                    "sample": self.samples[worst],
                }
        return found


@dataclass
class Difference:
    """Two sessions: samples of both, of one only; objects that came or went; what is the same byte for byte."""

    both: int = 0
    only_before: list[str] = field(default_factory=list)
    only_now: list[str] = field(default_factory=list)
    same_labels: int = 0
    same_pictures: int = 0
    gone: list[tuple[str, str]] = field(default_factory=list)
    new: list[tuple[str, str]] = field(default_factory=list)
    moved: dict[str, Moved] = field(default_factory=lambda: defaultdict(Moved))

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "samples": self.both,
            "only_before": self.only_before,
            "only_now": self.only_now,
            "same_labels": self.same_labels,
            "same_pictures": self.same_pictures,
            "objects_gone": [{"sample": sample, "object": name} for sample, name in self.gone],
            "objects_new": [{"sample": sample, "object": name} for sample, name in self.new],
            "objects": {name: moved.summary() for name, moved in sorted(self.moved.items())},
        }


def difference(before: Path, now: Path) -> Difference:
    """Compare two sessions sample by sample; raises DatasetError for a label that can't be read."""
    one, other = SessionReader(before), SessionReader(now)
    names, others = set(one.samples()), set(other.samples())
    found = Difference(only_before=sorted(names - others), only_now=sorted(others - names))
    for sample in sorted(names & others):
        _compare(one.label(sample), other.label(sample), found)
    return found


def _compare(one: Label, other: Label, found: Difference) -> None:
    found.both += 1
    found.same_labels += one.objects == other.objects and one.left_out == other.left_out
    if one.files is not None and other.files is not None:
        found.same_pictures += one.files.rgb.sha256 == other.files.rgb.sha256
    before, now = ({item.name: item for item in label.objects} for label in (one, other))
    found.gone += [(one.sample, name) for name in before if name not in now]
    found.new += [(one.sample, name) for name in now if name not in before]
    for name in before:
        if name in now:
            moved = found.moved[name]
            moved.samples.append(one.sample)
            for measure, value in zip(MEASURES, _measured(before[name], now[name]), strict=True):
                moved.values[measure].append(value)


def _measured(one: ObjectLabel, other: ObjectLabel) -> Iterator[float]:
    yield _largest(np.hypot(*(_corners(other) - _corners(one)).T))
    sides = [np.array(list(item.window_unclipped.model_dump().values())) for item in (one, other)]
    yield _largest(np.abs(sides[1] - sides[0]))
    before, now = Pose.from_label(one.pose), Pose.from_label(other.pose)
    yield float(np.linalg.norm(now.translation - before.translation))
    yield float(np.degrees(before.angle_to(now)))
    yield other.distance_mm - one.distance_mm


def _corners(item: ObjectLabel) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(8, 2) px, NaN behind the camera."""
    return np.array([(corner.x, corner.y) for corner in item.corners], dtype=np.float64)


def _largest(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else float("nan")
