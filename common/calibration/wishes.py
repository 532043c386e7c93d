"""What to show next: the parts of the picture, tilts and distances that a set of views still lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.calibration.diversity import GRID, Spread
from common.calibration.verdict import GOOD_TILT_DEG

WANTED_TILT_DEG = 35.0
WANTED_PER_TILT = 2
"""Views for each of the four directions of tilt, and as many without."""
_STRAIGHT_DEG = 12.0
TILTS: tuple[tuple[str, float], ...] = (("right", 0.0), ("bottom", 90.0), ("left", 180.0), ("top", 270.0))
"""Directions in the picture to which the board's normal may lean, with their angle (0 right, 90 down)."""


@dataclass(frozen=True)
class Wish:
    """The next pose to hold. ``place``: where in the picture the board's middle should be, 0..1 from its top left;
    ``tilt_deg`` and ``towards_deg`` as in ``Stance``; ``nearer``: -1 farther, 0 as it is, 1 nearer."""

    code: str
    words: str
    place: tuple[float, float] = (0.5, 0.5)
    tilt_deg: float = 0.0
    towards_deg: float = 0.0
    nearer: int = 0


def wishes(seen: Spread) -> tuple[Wish, ...]:
    """What the views lack, most important first; empty when nothing does.

    Tilts come first, since only they tell focal length from distance, each in the emptiest part of the picture.
    """
    place, name = _emptiest(seen)
    found = [
        Wish(f"tilt_{side}", f"tilt the board so that it looks to the {side}, {name}", place, WANTED_TILT_DEG, angle)
        for side, angle in TILTS
        if _tilted(seen, angle) < WANTED_PER_TILT
    ]
    straight = sum(stance.tilt_deg < _STRAIGHT_DEG for stance in seen.stances)
    if straight < WANTED_PER_TILT:
        found.append(Wish("straight", f"hold the board straight before the camera, {name}", place))
    if (seen.cells == 0).mean() > 0.15:
        found.append(Wish("cover", f"show the board {name}", place, 20.0, 0.0))
    if seen.stances and seen.distance_ratio < 1.3:
        found.append(Wish("nearer", "come nearer with the board, until it nearly fills the picture", nearer=1))
    return tuple(found)


def tilt_counts(seen: Spread) -> dict[str, int]:
    """How many views there are for each direction of tilt, and straight ones."""
    counts = {side: _tilted(seen, angle) for side, angle in TILTS}
    return counts | {"straight": sum(stance.tilt_deg < _STRAIGHT_DEG for stance in seen.stances)}


def _tilted(seen: Spread, towards: float) -> int:
    off = [abs((stance.towards_deg - towards + 180) % 360 - 180) for stance in seen.stances]
    return sum(
        angle <= 45 and stance.tilt_deg >= GOOD_TILT_DEG - 5 for angle, stance in zip(off, seen.stances, strict=True)
    )


def _emptiest(seen: Spread) -> tuple[tuple[float, float], str]:
    """Middle and name of the part (of nine) of the picture with the fewest covered cells; the rim before the middle."""
    columns, rows = GRID
    best: tuple[float, tuple[float, float], str] = (2.0, (0.5, 0.5), "in the middle of the picture")
    parts: Sequence[tuple[int, str]] = ((0, "upper"), (2, "lower"), (1, ""))
    for down, vertical in parts:
        for across, horizontal in ((0, "left"), (2, "right"), (1, "")):
            part = seen.cells[
                rows * down // 3 : rows * (down + 1) // 3, columns * across // 3 : columns * (across + 1) // 3
            ]
            share = float(np.mean(part > 0))
            name = in_words(" ".join(word for word in (vertical, horizontal) if word))
            if share < best[0] - 1e-9:
                best = (share, ((across + 0.5) / 3, (down + 0.5) / 3), name)
    return best[1], best[2]


def in_words(part: str) -> str:
    """A part of the picture by its name (``upper left``, ``right``, ``middle``) for a sentence."""
    return "in the middle of the picture" if part in ("", "middle") else f"at the {part} of the picture"


def place_of(part: str) -> tuple[float, float]:
    """The middle of a part of the picture by its name, 0..1 from the picture's top left."""
    words = part.split()
    across = 0 if "left" in words else 2 if "right" in words else 1
    down = 0 if "upper" in words else 2 if "lower" in words else 1
    return (across + 0.5) / 3, (down + 0.5) / 3
