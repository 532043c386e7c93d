"""The sessions that are exported: their objects, and their samples as they lie on the disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from common.config.differences import differences
from common.dataset import SESSION_FILE, SessionFile, SessionReader
from common.dataset.boxes import boxes_of
from common.errors import DatasetError, RefusedError
from tools.export.model import Source


def read_sources(folders: Sequence[Path]) -> list[Source]:
    """All samples of the sessions, those of one session oldest first; raises RefusedError and DatasetError.

    Sessions that describe an object differently, or were recorded with another marker family, are refused.
    """
    seen: dict[Path, Path] = {}
    files: list[tuple[Path, SessionFile]] = []
    for folder in folders:
        if folder.resolve() in seen:
            raise RefusedError(f"session {folder} is named twice", code="refused")
        seen[folder.resolve()] = folder
        files.append((folder, SessionReader(folder).session))
    _agree(files)
    sources: list[Source] = []
    for folder, file in files:
        reader, boxes = SessionReader(folder), {box.name: box for box in boxes_of(file, folder)}
        for sample in reader.samples():
            label = reader.label(sample)
            if label.files is None:
                raise DatasetError(f"the label of {sample} names no files; it never went through the store")
            strange = [item.name for item in label.objects if item.name not in boxes]
            if strange:
                raise DatasetError(
                    f"{folder / SESSION_FILE} doesn't describe {strange[0]}, which sample {sample} shows; "
                    "its size is needed"
                )
            sources.append(Source(folder, label, boxes))
    if not sources:
        raise RefusedError(
            f"there is no sample in {', '.join(str(folder) for folder in folders)}; record some first", code="no_sample"
        )
    return sources


def _agree(files: Sequence[tuple[Path, SessionFile]]) -> None:
    """Refuse sessions that can't be one training set."""
    for index, (folder, file) in enumerate(files):
        for earlier, other in files[:index]:
            found = _differences(other.rig, file.rig)
            if found:
                raise RefusedError(
                    f"{earlier} and {folder} can't be one training set: {found[0]}"
                    + (f" (and {len(found) - 1} more)" if len(found) > 1 else "")
                    + "; export them apart",
                    code="session_differs",
                )


def _differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """In the marker family, and in objects that both have: their type, size, and which face is which side."""
    both = (one.get("objects") or {}).keys() & (other.get("objects") or {}).keys()
    return differences(_essence(one, both), _essence(other, both))


def _essence(rig: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    objects = rig.get("objects") or {}
    return {
        "markers": rig.get("markers"),
        "objects": {
            name: {
                "type": objects[name].get("type"),
                "size_mm": objects[name].get("size_mm"),
                "sides": {side: row.get("face") for side, row in (objects[name].get("sides") or {}).items()},
            }
            for name in sorted(names)
        },
    }
