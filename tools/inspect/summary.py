"""What is in a session: counts, coverage, shares, near-duplicates, the ledger. Pure."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.dataset import SessionFile
from common.geometry import Pose
from common.quality.duplicates import ALIKE_BITS, differing_bits, near_views
from tools.inspect.facts import Facts, ObjectFacts

AZIMUTHS, ELEVATIONS = 12, 6
"""Cells of the view sphere: 30 degrees each."""
DISTANCE_STEP_MM, ANGLE_STEP_DEG = 100.0, 10.0


@dataclass(frozen=True)
class Spread:
    """Median, and where the middle nine tenths lie."""

    median: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Summary:
    """A session in numbers. ``coverage``: for each object the samples in each cell of the view sphere around it.

    ``erased``: by class, the share of the window that was erased. ``alike``: groups of near-duplicates (indices).
    """

    name: str
    samples: int
    bytes: int
    in_bin: int
    by_camera: dict[str, int]
    by_object: dict[str, int]
    by_class: dict[str, int]
    background: int
    coverage: dict[str, list[list[int]]]
    distances: dict[str, Spread]
    angles: dict[str, Spread]
    erased: dict[str, Spread]
    residual: Spread | None
    corner_sigma: Spread | None
    distance_sigma: Spread | None
    blur: Spread | None
    brightness: Spread | None
    alike: tuple[tuple[int, ...], ...]
    ledger: tuple[dict[str, Any], ...]

    @property
    def duplicates(self) -> int:
        """Samples that could go and leave one of each group."""
        return sum(len(group) - 1 for group in self.alike)


def summarise(facts: Sequence[Facts], session: SessionFile | None, name: str, in_bin: int) -> Summary:
    """All numbers of a session."""
    seen = [one for one in facts if one.readable]
    items = [item for one in seen for item in one.objects]
    return Summary(
        name=name,
        samples=len(facts),
        bytes=sum(one.bytes for one in facts),
        in_bin=in_bin,
        by_camera=dict(sorted(Counter(one.camera for one in facts).items())),
        by_object=dict(sorted(Counter(item.name for item in items).items())),
        by_class=dict(sorted(Counter(item.class_name or "(no side)" for item in items).items())),
        background=sum(one.background for one in seen),
        coverage=_coverage(items),
        distances=_by(items, "name", "distance_mm"),
        angles=_by(items, "class_name", "angle_deg"),
        erased=_by(items, "class_name", "erased"),
        residual=_spread(item.residual_px for item in items),
        corner_sigma=_spread(item.corner_sigma_px for item in items),
        distance_sigma=_spread(item.distance_sigma_mm for item in items),
        blur=_spread(one.blur for one in seen),
        brightness=_spread(one.brightness for one in seen),
        alike=_alike(facts),
        ledger=tuple(_ledger(session)),
    )


def _coverage(items: Iterable[ObjectFacts]) -> dict[str, list[list[int]]]:
    cells: dict[str, list[list[int]]] = defaultdict(lambda: [[0] * AZIMUTHS for _ in range(ELEVATIONS)])
    for item in items:
        column = int((item.azimuth_deg % 360.0) // (360 / AZIMUTHS)) % AZIMUTHS
        row = min(int((90.0 - item.elevation_deg) // (180 / ELEVATIONS)), ELEVATIONS - 1)
        cells[item.name][row][column] += 1
    return dict(sorted(cells.items()))


def _by(items: Iterable[ObjectFacts], key: str, value: str) -> dict[str, Spread]:
    values: dict[str, list[float]] = defaultdict(list)
    for item in items:
        if getattr(item, key):
            values[getattr(item, key)].append(getattr(item, value))
    found = {name: _spread(numbers) for name, numbers in sorted(values.items())}
    return {name: spread for name, spread in found.items() if spread is not None}


def _spread(values: Iterable[float | None]) -> Spread | None:
    known = np.array([value for value in values if value is not None and np.isfinite(value)])
    if not len(known):
        return None
    low, middle, high = np.percentile(known, [5, 50, 95])
    return Spread(float(middle), float(low), float(high))


def _alike(facts: Sequence[Facts]) -> tuple[tuple[int, ...], ...]:
    """Groups of samples that look alike and show their objects from the same place, by camera; largest first."""
    groups: list[tuple[int, ...]] = []
    for camera in sorted({one.camera for one in facts}):
        indices = [index for index, one in enumerate(facts) if one.camera == camera and one.readable]
        if len(indices) < 2:
            continue
        views = [{item.name: _pose(item) for item in facts[index].objects} for index in indices]
        hashes = np.array([facts[index].alike for index in indices], dtype=np.uint64)
        near = near_views(views, views)
        left = set(range(len(indices)))
        for first in range(len(indices)):
            if first not in left:
                continue
            bits = differing_bits(int(hashes[first]), hashes)
            group = [other for other in sorted(left) if near[first, other] and bits[other] <= ALIKE_BITS]
            left -= {first, *group}
            if len(group) > 1:
                groups.append(tuple(indices[other] for other in group))
    return tuple(sorted(groups, key=lambda group: (-len(group), group)))


def _pose(item: ObjectFacts) -> Pose:
    return Pose(item.pose[:3, :3], item.pose[:3, 3])


def _ledger(session: SessionFile | None) -> Iterable[dict[str, Any]]:
    """A row a recording and camera, then one a camera for all single requests."""
    if session is None:
        return
    for name, ledger in sorted(session.recordings.items()):
        for camera, account in sorted(ledger.cameras.items()):
            yield {"recording": name, "camera": camera, "phase": ledger.phase, **_account(account.model_dump())}
    for camera, account in sorted(session.records.items()):
        yield {"recording": "single requests", "camera": camera, "phase": "ended", **_account(account.model_dump())}


def _account(plain: dict[str, Any]) -> dict[str, Any]:
    refused, dropped = sum(plain["refused"].values()), sum(plain["dropped"].values())
    return {
        "captured": plain["captured"],
        "recorded": plain["recorded"],
        "refused": plain["refused"],
        "dropped": plain["dropped"],
        "deleted": plain["deleted"],
        "adds_up": plain["captured"] == plain["recorded"] + refused + dropped,
    }
