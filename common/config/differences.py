"""What a label depends on, in plain values, and how two such states differ."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from common.geometry import Box, BoxSide, MarkerOnSide
from common.labels import CameraLabel

NONE = "(none)"


def plain_objects(boxes: Sequence[Box]) -> dict[str, Any]:
    """The objects by name, every default written out, so that two ways of writing the same are equal."""
    return {
        box.name: {
            "type": box.type,
            "size_mm": dict(zip(("width", "height", "depth"), map(float, box.size_mm), strict=True)),
            "sides": {side.class_name: _plain_side(side) for side in box.sides},
        }
        for box in boxes
    }


def _plain_side(side: BoxSide) -> dict[str, Any]:
    if len(side.markers) == 1:
        return {"face": side.face, "marker": side.markers[0].id, **_plain_marker(side.markers[0])}
    return {"face": side.face, "markers": {str(marker.id): _plain_marker(marker) for marker in side.markers}}


def _plain_marker(marker: MarkerOnSide) -> dict[str, Any]:
    return {
        "marker_size_mm": float(marker.size_mm),
        "border_mm": float(marker.border_mm),
        "offset_mm": [float(value) for value in marker.offset_mm],
        "rotation_deg": float(marker.rotation_deg),
    }


def plain_family(name: str, folder: Path) -> dict[str, Any]:
    """The marker family: its name, and what a custom dictionary's file contains."""
    path = folder / name
    if not path.is_file():
        return {"family": name}
    return {"family": name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def plain_calibration(label: CameraLabel | None) -> dict[str, Any] | None:
    """A calibration's content, without where it stood."""
    if label is None:
        return None
    return {
        "width": label.width,
        "height": label.height,
        "model": label.model,
        "camera_matrix": [list(row) for row in label.matrix],
        "distortion": list(label.distortion),
        "serial": label.serial,
    }


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """How two ``Rig.as_plain()`` differ in what a label depends on, one readable line each.

    Objects, markers, and the calibration of a camera that both know. A camera that only one of them has is no
    difference, nor is a frame rate. E.g. ``objects.box-1.sides.front.marker_size_mm: 50 -> 40``.
    """
    found: list[str] = []
    for section in ("markers", "objects"):
        _compare(section, before.get(section), after.get(section), found)
    cameras_before, cameras_after = before.get("cameras") or {}, after.get("cameras") or {}
    for name in cameras_before:
        if name in cameras_after:
            one, other = cameras_before[name].get("calibration"), cameras_after[name].get("calibration")
            _compare(f"cameras.{name}.calibration", one, other, found)
    return found


def _compare(where: str, before: Any, after: Any, found: list[str]) -> None:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in [*before, *(key for key in after if key not in before)]:
            _compare(f"{where}.{key}", before.get(key), after.get(key), found)
    elif _numbers_as_float(before) != _numbers_as_float(after):
        found.append(f"{where}: {_shown(before)} -> {_shown(after)}")


def _numbers_as_float(value: Any) -> Any:
    """Lists instead of tuples and floats instead of whole numbers, as JSON may hand them back."""
    if isinstance(value, list | tuple):
        return [_numbers_as_float(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _shown(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_shown(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(item) for item in value) + "]"
    return f"{value:.10g}" if isinstance(value, float) else str(value)
