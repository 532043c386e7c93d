"""What a calibration knows of its own quality: the ``quality`` part of its file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from common.config.problems import Problems
from common.config.tree import read_tree


class Quality(BaseModel):
    """All figures are of the views that were used; px of the calibrated pictures, mm, percent.

    ``verdict`` with its ``reasons``; ``model``: the lens model's name, chosen among others by ``held_out_px``;
    ``sd``: standard deviations of the parameters by name; ``focal_percent``: that of the focal length, which is what
    distances are off by; ``projection_px``: greatest uncertainty of a projected point in the picture,
    ``distance_mm`` away; ``covered_percent`` of the picture; ``board_bent_mm``: the board's estimated deflection.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    verdict: Literal["good", "usable", "not yet"]
    reasons: tuple[str, ...] = ()
    board: str = ""
    lens: str = ""
    views: int = 0
    dropped: tuple[str, ...] = ()
    corners: int = 0
    rms_px: float = 0.0
    held_out_px: float | None = None
    sd: dict[str, float] = {}
    focal_percent: float = 0.0
    projection_px: float | None = None
    distance_mm: float = 0.0
    covered_percent: float = 0.0
    tilts_span_deg: float = 0.0
    board_bent_mm: float = 0.0


def read_quality(path: Path) -> Quality | None:
    """What a calibration file says of its own quality; None for one that says nothing (or is another's format)."""
    tree = read_tree(path, Problems(path), "calibration file")
    found = None if tree is None else tree.child("quality")
    if found is None:
        return None
    try:
        return Quality.model_validate(found.plain())
    except ValidationError:
        return None
