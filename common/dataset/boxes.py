"""The rig's objects as ``session.json`` keeps them: boxes again, with their sides and markers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from common.dataset.layout import SESSION_FILE
from common.dataset.session import SessionFile
from common.errors import DatasetError
from common.geometry import Box, BoxSide, MarkerOnSide


def boxes_of(session: SessionFile, folder: Path) -> tuple[Box, ...]:
    """The objects in their order; raises DatasetError that names the object which is described badly.

    The inverse of ``common.config.differences.plain_objects``. ``folder`` is named in the error only.
    """
    found = []
    for name, plain in (session.rig.get("objects") or {}).items():
        try:
            found.append(_box(str(name), plain))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DatasetError(f"{folder / SESSION_FILE}: the object {name} is described badly: {error!r}") from error
    return tuple(found)


def _box(name: str, plain: Mapping[str, Any]) -> Box:
    size = plain["size_mm"]
    sides = tuple(
        BoxSide(str(side), row["face"], tuple(_markers(row))) for side, row in (plain.get("sides") or {}).items()
    )
    numbers = (float(size["width"]), float(size["height"]), float(size["depth"]))
    return Box(name, str(plain["type"]), numbers, sides)


def _markers(row: Mapping[str, Any]) -> Iterator[MarkerOnSide]:
    placed = {row["marker"]: row} if "marker" in row else row.get("markers") or {}
    for marker, about in placed.items():
        right, up, out = (*map(float, about["offset_mm"]), 0.0, 0.0)[:3]
        yield MarkerOnSide(
            int(marker),
            float(about["marker_size_mm"]),
            float(about["border_mm"]),
            (right, up, out),
            float(about["rotation_deg"]),
        )
