"""A view: the corners of a board found in one picture. The calibration sees nothing else of a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """``ids`` (N,), ``points`` (N, 3) mm in the board frame, ``corners`` (N, 2) px, integer = pixel centre.

    ``size``: the picture's width and height. ``edge_px``: how wide the board's edges are in it (10 to 90 % of the
    step; 0: not measured). ``spacing_px``: the least distance of two corners. ``notes``: what a person should know.
    """

    name: str
    size: tuple[int, int]
    ids: NDArray[np.int64]
    points: Array
    corners: Array
    edge_px: float = 0.0
    spacing_px: float = 0.0
    notes: tuple[str, ...] = ()

    def kept(self, mask: NDArray[np.bool_]) -> View:
        """The view with some of its corners only."""
        return replace(self, ids=self.ids[mask], points=self.points[mask], corners=self.corners[mask])

    def document(self) -> dict[str, Any]:
        """For JSON or YAML; ``view_from`` reads it."""
        return {
            "name": self.name,
            "size": list(self.size),
            "ids": self.ids.tolist(),
            "points": self.points.tolist(),
            "corners": np.round(self.corners, 4).tolist(),
            "edge_px": round(self.edge_px, 3),
            "spacing_px": round(self.spacing_px, 3),
            "notes": list(self.notes),
        }


def view_from(document: Mapping[str, Any]) -> View:
    """The view that ``View.document`` described. Raises ValueError or KeyError where something is amiss."""
    ids = np.array(document["ids"], dtype=np.int64)
    points = np.array(document["points"], dtype=np.float64).reshape(-1, 3)
    corners = np.array(document["corners"], dtype=np.float64).reshape(-1, 2)
    if not len(ids) == len(points) == len(corners):
        raise ValueError(f"view {document['name']}: {len(ids)} ids, {len(points)} points, {len(corners)} corners")
    if not (np.isfinite(points).all() and np.isfinite(corners).all()):
        raise ValueError(f"view {document['name']}: its numbers must be finite")
    width, height = (int(side) for side in document["size"])
    return View(
        str(document["name"]), (width, height), ids, points, corners,
        float(document["edge_px"]), float(document["spacing_px"]), tuple(str(note) for note in document["notes"]),
    )  # fmt: skip
