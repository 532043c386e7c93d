"""From sessions and options to a planned export: which samples, which part, which picture, which targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import RefusedError
from common.geometry import Box, CameraModel
from services.label.visibility import facing_side
from tools.export.classes import Naming, naming
from tools.export.model import Export, Exporter, Shot, Source
from tools.export.options import Options, PictureWish
from tools.export.pictures import Change
from tools.export.select import WORDS, Selected, select
from tools.export.sessions import read_sources
from tools.export.split import Parted, part
from tools.export.targets import targets_of

_TRAPS = ("JPEGImages", "images", "labels")
"""Words that Darknet looks for in a picture's path to find its label."""


@dataclass(frozen=True)
class Plan:
    """The export, what was left out of it (reason to number), how it was parted, and what else is to be said."""

    export: Export
    read: int
    left_out: Mapping[str, int]
    parted: Parted
    notes: tuple[str, ...]


def plan_export(name: str, exporter: Exporter, sessions: Sequence[Path], options: Options, workers: int) -> Plan:
    """Read the sessions and plan the export; raises RefusedError and DatasetError, each with one sentence."""
    sources = read_sources(sessions)
    boxes: dict[str, Box] = {}
    for source in sources:
        boxes |= source.boxes
    names = _naming(name, exporter, options, boxes)
    selected = select(sources, options.filters, workers)
    parted = part(selected.kept, options.split, workers)
    shots = _shots(selected, parted, exporter, options, names)
    found = Counter(target.class_name for shot in shots for target in shot.targets)
    if not found:
        raise RefusedError(f"none of the {len(shots)} samples shows anything of a class", code="no_object")
    stated = _stated(name, sources, selected, parted, options, names)
    export = Export(name, names.names, tuple(shots), stated)
    notes = [f"class '{one}' has no sample" for one in names.names if not found[one]]
    notes += _unnamed(selected, names, options)
    left_out = Counter(selected.left_out)
    left_out.update({"neighbour": parted.left_out} if parted.left_out else {})
    return Plan(export, len(sources), left_out, parted, (*notes, *exporter.notes(export)))


def left_out_words(reason: str) -> str:
    """A reason as a person reads it."""
    return "near-duplicates of a sample that is held back" if reason == "neighbour" else WORDS[reason]


def _naming(name: str, exporter: Exporter, options: Options, boxes: Mapping[str, Box]) -> Naming:
    wish = options.classes or ("side" if options.all_sides else exporter.traits.default_classes)
    found = naming(wish, boxes.values(), all_sides=options.all_sides)
    if exporter.traits.whole and found.by_side:
        raise RefusedError(
            f"{name} describes whole objects: take --classes type, or a file that maps objects and types",
            code="refused",
        )
    if not found.names:
        raise RefusedError("the sessions' rigs have no side; take --classes type", code="refused")
    return found


def _shots(selected: Selected, parted: Parted, exporter: Exporter, options: Options, names: Naming) -> list[Shot]:
    stems = _stems(selected.kept)
    changes: dict[tuple[object, ...], Change] = {}
    cameras: dict[int, CameraModel] = {}
    shots: list[Shot] = []
    for source, stem, split in zip(selected.kept, stems, parted.parts, strict=True):
        if split is None:
            continue
        change = _change(source, options.pictures, exporter, changes)
        if id(change) not in cameras:
            cameras[id(change)] = change.exported_camera()
        camera = cameras[id(change)]
        targets = targets_of(source, camera, names, options.filters.objects, all_sides=options.all_sides)
        if exporter.traits.whole:
            targets = tuple(target for target in targets if np.isfinite(target.corners).all())
        shots.append(Shot(len(shots), stem, split, source, camera, change, targets))
    return shots


def _stems(sources: Sequence[Source]) -> list[str]:
    """A name for each picture: the sample's, with its session's where two are alike, without Darknet's words."""
    counts = Counter(source.label.sample for source in sources)
    stems = []
    for source in sources:
        stem = source.label.sample
        if counts[stem] > 1:
            stem = f"{source.folder.name}-{stem}"
        for word in _TRAPS:
            stem = stem.replace(word, f"{word[0]}_{word[1:]}")
        stems.append(stem)
    return stems


def _change(source: Source, wish: PictureWish, exporter: Exporter, known: dict[tuple[object, ...], Change]) -> Change:
    label = source.label.camera
    stored = source.picture.suffix.lstrip(".").lower().replace("jpeg", "jpg")
    key = (label.width, label.height, label.matrix, label.distortion, label.model, stored)
    if key not in known:
        camera = CameraModel.from_label(label)
        bends = bool(np.any(camera.distortion)) or camera.model == "fisheye"
        extension = wish.extension or (stored if stored in exporter.traits.pictures else exporter.traits.pictures[0])
        if extension not in exporter.traits.pictures:
            raise RefusedError(
                f"this format takes {' or '.join(exporter.traits.pictures)} pictures only, not {extension}",
                code="refused",
            )
        known[key] = Change(
            camera=camera,
            size=wish.size or (camera.width, camera.height),
            fit="letterbox" if wish.letterbox else "stretch",
            undistort=exporter.traits.undistorted and bends,
            extension=extension,
            stored_as=stored,
            quality=wish.quality,
        )
    return known[key]


def _unnamed(selected: Selected, names: Naming, options: Options) -> list[str]:
    """Objects that are in the pictures but have no class there."""
    if options.all_sides or (not names.by_side and names.by_type):
        return []
    count = sum(
        1
        for source in selected.kept
        for item in source.label.objects
        if (not options.filters.objects or item.name in options.filters.objects)
        and _class_of(source, item.name, names) is None
    )
    return [f"{count} views of an object have no class (no side with one faces the camera)"] if count else []


def _class_of(source: Source, name: str, names: Naming) -> str | None:
    facing = facing_side(source.boxes[name], source.poses[name])
    return names.class_of(source.boxes[name], None if facing is None else facing[0])


def _stated(
    name: str,
    sources: Sequence[Source],
    selected: Selected,
    parted: Parted,
    options: Options,
    names: Naming,
) -> dict[str, Any]:
    """What the export says of itself: enough to make it again, and to judge it."""
    units: dict[str, dict[str, Any]] = {}
    for unit, split in zip(parted.units, parted.parts, strict=True):
        row = units.setdefault(unit, {"part": split, "samples": 0, "neighbours_left_out": 0})
        row["samples" if split else "neighbours_left_out"] += 1
        row["part"] = row["part"] or split
    return {
        "format": name,
        "sessions": {source.folder.name: str(source.folder) for source in sources},
        "classes": list(names.names),
        "samples_read": len(sources),
        "left_out": dict(sorted(selected.left_out.items())),
        "split": {
            "by": parted.by,
            "seed": options.split.seed,
            "val": options.split.val,
            "test": options.split.test,
            "reasons": list(parted.reasons),
            "units": units,
        },
    }
