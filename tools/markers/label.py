"""What is written beside a marker, and which way is up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.config import Rig
from common.geometry import BoxSide, MarkerOnSide
from common.labels import FaceName
from common.markers import Family, family
from tools.check import MUCH, CoveredShare, covered_shares

Array = NDArray[np.float64]

_UP: dict[FaceName, str] = {"top": "the back", "bottom": "the front"}
"""Where the up of a side points, as design and rig reference say; of all other sides to the object's top."""
_ARROW = np.array([[0, -1], [0.62, -0.1], [0.22, -0.1], [0.22, 1], [-0.22, 1], [-0.22, -0.1], [-0.62, -0.1]])


@dataclass(frozen=True, slots=True)
class RigMarker:
    """A marker of a rig with all that the sheet says of it."""

    object: str
    side: BoxSide
    marker: MarkerOnSide
    family: Family
    share: CoveredShare

    @property
    def edge_mm(self) -> float:
        """Side of what is cut out: the black square with its white border."""
        return self.marker.size_mm + 2 * self.marker.border_mm

    @property
    def cell_mm(self) -> float:
        """Side of one cell of the pattern: the least white border that a detector likes to see."""
        return self.marker.size_mm / self.family.cells

    @property
    def name(self) -> str:
        """Names a file of this marker alone."""
        return f"{self.object}-{self.side.class_name}-{self.marker.id}"


def rig_markers(rig: Rig) -> tuple[RigMarker, ...]:
    """All markers of a rig, in its order."""
    known = family(rig.config.markers.family, rig.folder)
    shares = iter(covered_shares(rig))
    return tuple(
        RigMarker(box.name, side, marker, known, next(shares)) for box in rig.boxes for side, marker in box.markers()
    )


def title(one: RigMarker) -> str:
    """The label's first line."""
    return f"id {one.marker.id} · {one.object} · {one.side.class_name}"


def label_lines(one: RigMarker) -> Iterator[str]:
    """The label's further lines."""
    marker, side = one.marker, one.side
    face = "" if side.class_name == side.face else f"{side.face} face, "
    yield f"{face}{one.family.name}"
    yield f"black square {marker.size_mm:g} mm, border {marker.border_mm:g} mm"
    yield _place(marker)
    if marker.rotation_deg % 360:
        yield f"turned {_turn(marker.rotation_deg)}"
    yield f"arrow: to {_UP.get(side.face, 'the top')} of the object"
    much = ": much, see place-markers" if one.share.part > MUCH else ""
    yield f"erasing it takes {one.share.part:.1%} of the side{much}"


def _place(marker: MarkerOnSide) -> str:
    right, up, out = marker.offset_mm
    parts = [
        f"{abs(value):g} mm {positive if value > 0 else negative}"
        for value, positive, negative in ((right, "right", "left"), (up, "up", "down"), (out, "out", "in"))
        if value
    ]
    return f"{', '.join(parts)} from the side's centre" if parts else "at the side's centre"


def _turn(degrees: float) -> str:
    turned = (degrees + 180) % 360 - 180
    return f"{abs(turned):g}° {'counter-clockwise' if turned > 0 else 'clockwise'} on the side"


def up_direction(rotation_deg: float) -> Array:
    """Where the *side's* up points on the printed marker (2,), x right, y down: a marker that is to be stuck on turned
    counter-clockwise has it turned clockwise."""
    angle = np.radians(rotation_deg)
    return np.array([np.sin(angle), -np.cos(angle)])


def arrow(centre: Array, rotation_deg: float, length: float) -> Array:
    """An arrow (7, 2) in the direction of ``up_direction``."""
    up = up_direction(rotation_deg)
    right = np.array([-up[1], up[0]])
    return np.asarray(centre + (_ARROW[:, :1] * right - _ARROW[:, 1:] * up) * length / 2)
