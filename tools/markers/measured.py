"""What a printed ruler that isn't 100 mm long says of everything else on the paper."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from typing import Any

from tools.markers.label import RigMarker
from tools.markers.ruler import LENGTH_MM

_LEAST_MM, _MOST_MM = 50.0, 200.0
READING_MM = 0.1
"""As exactly as a person reads a ruler; less is no reason to change anything."""


def parse_measured(text: str) -> float:
    """For argparse: what the ruler measured, mm."""
    try:
        value = float(text.replace(",", ".").removesuffix("mm"))
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"'{text}' is no length; write what the ruler measures in mm, such as 98.7")
    if not _LEAST_MM <= value <= _MOST_MM:
        centimetres = "; it looks like centimetres" if _LEAST_MM <= 10 * value <= _MOST_MM else ""
        raise argparse.ArgumentTypeError(
            f"{text} mm can't be what the {LENGTH_MM} mm ruler measures ({_LEAST_MM:g} to {_MOST_MM:g}){centimetres}"
        )
    return value


def document(markers: Sequence[RigMarker], measured_mm: float) -> dict[str, Any]:
    """For programs: scale, and each marker's real sizes."""
    scale = measured_mm / LENGTH_MM
    return {
        "ok": True,
        "measured_mm": measured_mm,
        "scale": round(scale, 6),
        "print_at_percent": round(100 / scale, 3),
        "true": is_true(measured_mm),
        "markers": [
            {"object": one.object, "side": one.side.class_name, "marker": one.marker.id}
            | {"marker_size_mm": _real(one.marker.size_mm, scale), "border_mm": _real(one.marker.border_mm, scale)}
            for one in markers
        ],
    }


def words(markers: Sequence[RigMarker], measured_mm: float, rig: str) -> Iterator[str]:
    """For people: print again at another scale, or correct the rig file."""
    scale = measured_mm / LENGTH_MM
    if is_true(measured_mm):
        yield f"The ruler measures {measured_mm:g} mm: true to scale, nothing to correct."
        return
    yield f"The ruler measures {measured_mm:g} mm instead of {LENGTH_MM}: the print is at {scale:.2%} of true scale."
    yield ""
    yield f"Either print again at {1 / scale:.2%} and measure again, or keep the print and correct {rig}:"
    yield ""
    before = ""
    for one in markers:
        if one.object != before:
            yield f"  {one.object}:"
            before = one.object
        size, border = _real(one.marker.size_mm, scale), _real(one.marker.border_mm, scale)
        yield f"    {one.side.class_name}: marker: {one.marker.id}, marker_size_mm: {size:g}, border_mm: {border:g}"


def is_true(measured_mm: float) -> bool:
    """Whether the print is as true as a ruler can tell."""
    return abs(measured_mm - LENGTH_MM) <= READING_MM + 1e-9


def _real(value: float, scale: float) -> float:
    return round(value * scale, 2)
