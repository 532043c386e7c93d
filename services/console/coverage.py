"""From where an object was recorded: a map of directions, a histogram of distances, and what is missing. Pure.

Directions are in the object's own frame (azimuth 0 before the front, 90 right; elevation 90 above the top). A cell of
the map is wanted if a side with a marker can be seen from its middle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.geometry import FACES
from common.labels import FaceName
from services.console.line import Plain

AZIMUTH_EDGES = tuple(range(-180, 181, 30))
ELEVATION_EDGES = tuple(range(-90, 91, 30))
SEEN_WITHIN_DEG = 65.0
"""A marker seen more askew than this is seldom found."""
_MOST_DISTANCES = 24
_STEPS_MM = (50, 100, 200, 500, 1000, 2000, 5000)
_WORTH_SAYING_DEG = 12.0


def direction(azimuth_deg: float, elevation_deg: float) -> NDArray[np.float64]:
    """The unit vector (3,) from the object to the camera, object frame."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    across = math.cos(elevation)
    return np.array([across * math.sin(azimuth), -across * math.cos(azimuth), math.sin(elevation)])


def cell_of(azimuth_deg: float, elevation_deg: float) -> tuple[int, int]:
    """The cell (row of elevation, column of azimuth) of a direction."""
    row = min(int((elevation_deg + 90.0) // 30.0), len(ELEVATION_EDGES) - 2)
    column = int(((azimuth_deg + 180.0) % 360.0) // 30.0)
    return max(row, 0), min(column, len(AZIMUTH_EDGES) - 2)


def wanted_cells(faces: Iterable[FaceName]) -> NDArray[np.bool_]:
    """Which cells of the map can be recorded at all, (rows, columns)."""
    normals = np.array([FACES[face].normal for face in faces], dtype=np.float64).reshape(-1, 3)
    limit = math.cos(math.radians(SEEN_WITHIN_DEG))
    return np.array(
        [
            [bool((normals @ direction(column + 15.0, row + 15.0) >= limit).any()) for column in AZIMUTH_EDGES[:-1]]
            for row in ELEVATION_EDGES[:-1]
        ]
    )


@dataclass(frozen=True, slots=True)
class Views:
    """The recorded views of one object: directions (N, 3), azimuth and elevation (deg), distances (mm)."""

    directions: NDArray[np.float64]
    angles: NDArray[np.float64]
    distances: NDArray[np.float64]

    @classmethod
    def of(cls, samples: Iterable[Plain], name: str) -> Views:
        """Those of the listed samples in which the object is."""
        found = [
            (item["azimuth_deg"], item["elevation_deg"], item["distance_mm"])
            for sample in samples
            for item in sample["objects"]
            if item["name"] == name
        ]
        table = np.array(found, dtype=np.float64).reshape(-1, 3)
        directions = np.array([direction(azimuth, elevation) for azimuth, elevation in table[:, :2]]).reshape(-1, 3)
        return cls(directions, table[:, :2], table[:, 2])

    def nearest(
        self, seen: NDArray[np.float64], distance_mm: float, within_deg: float, within_mm: float
    ) -> tuple[float | None, float | None]:
        """How new a view is: degrees to the nearest one of about that distance, mm to the nearest one of about that
        direction; None where there is none, so that it is new whatever the other says.
        """
        if not len(self.distances):
            return None, None
        apart = np.degrees(np.arccos(np.clip(self.directions @ seen, -1.0, 1.0)))
        away = np.abs(self.distances - distance_mm)
        near, along = away < within_mm, apart < within_deg
        return (
            float(apart[near].min()) if near.any() else None,
            float(away[along].min()) if along.any() else None,
        )

    def counts(self) -> NDArray[np.int64]:
        """How many in each cell, (rows, columns)."""
        counts = np.zeros((len(ELEVATION_EDGES) - 1, len(AZIMUTH_EDGES) - 1), dtype=np.int64)
        for azimuth, elevation in self.angles:
            counts[cell_of(float(azimuth), float(elevation))] += 1
        return counts


def answer(name: str, views: Views, wanted: NDArray[np.bool_], now: tuple[float, float] | None) -> Plain:
    """What `GET /api/coverage` says of an object; ``now`` is the present azimuth and elevation."""
    counts = views.counts()
    missing = wanted & (counts == 0)
    return {
        "object": name,
        "bins": {"azimuth": list(AZIMUTH_EDGES), "elevation": list(ELEVATION_EDGES)},
        "counts": counts.tolist(),
        "wanted": wanted.tolist(),
        "distances": _distances(views.distances),
        "total": len(views.distances),
        "views_covered": int((wanted & (counts > 0)).sum()),
        "views_wanted": int(wanted.sum()),
        "next": next_view(name, missing, now),
    }


def next_view(name: str, missing: NDArray[np.bool_], now: tuple[float, float] | None) -> str | None:
    """One sentence: how to come to the nearest view that is missing; None if none is."""
    cells = [(AZIMUTH_EDGES[j] + 15.0, ELEVATION_EDGES[i] + 15.0) for i, j in np.argwhere(missing)]
    if not cells:
        return None
    if now is None:
        azimuth, elevation = min(cells, key=lambda cell: (abs(cell[1] - 15.0), abs(cell[0])))
        return f"Show {name} {_words_for(azimuth, elevation)}."
    here = direction(*now)
    azimuth, elevation = max(cells, key=lambda cell: float(here @ direction(*cell)))
    turn = (azimuth - now[0] + 180.0) % 360.0 - 180.0
    tilt = elevation - now[1]
    steps = []
    if abs(turn) >= _WORTH_SAYING_DEG:
        # Its right side comes to the camera when what faces the camera goes to the left.
        steps.append(f"turn {name} about {_round(turn)}° to the {'left' if turn > 0 else 'right'}")
    if abs(tilt) >= _WORTH_SAYING_DEG:
        way = "the camera higher or its top towards the camera" if tilt > 0 else "the camera lower or its top away"
        steps.append(f"bring {way} by about {_round(tilt)}°")
    sentence = ", and ".join(steps) or f"turn {name} a little"
    return f"{sentence[:1].upper()}{sentence[1:]}."


def _round(degrees: float) -> int:
    return max(5, 5 * round(abs(degrees) / 5))


def _words_for(azimuth: float, elevation: float) -> str:
    sides = ("behind", "the left", "the front", "the right", "behind")
    side = sides[round((azimuth + 180.0) / 90.0)]
    height = "above" if elevation > 30.0 else "below" if elevation < -30.0 else ""
    return f"from {side}" + (f" and {height}" if height else "")


def _distances(distances: NDArray[np.float64]) -> dict[str, list[int]]:
    furthest = float(distances.max(initial=0.0))
    step = next((step for step in _STEPS_MM if furthest / step < _MOST_DISTANCES), _STEPS_MM[-1])
    edges = np.arange(0, (int(furthest // step) + 2) * step, step)
    counts, _ = np.histogram(distances, edges)
    return {"edges_mm": edges.tolist(), "counts": counts.tolist()}


def faces_with_markers(sides: Sequence[Any]) -> tuple[FaceName, ...]:
    """The faces of a box (of the rig) that carry a marker."""
    return tuple(dict.fromkeys(side.face for side in sides))
