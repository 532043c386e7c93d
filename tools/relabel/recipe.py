"""By what a session is labelled again: objects, markers and options of a rig, and calibrations of its cameras."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from common.config import load_rig
from common.config.calibration import read_calibration
from common.config.dataset import DatasetConfig
from common.config.differences import differences, plain_calibration
from common.config.models import InpaintConfig, PoseConfig, RecordConfig
from common.dataset import SESSION_FILE, SessionFile
from common.dataset.boxes import boxes_of
from common.errors import ConfigError, DatasetError, RefusedError
from common.geometry import Box
from common.labels import CameraLabel
from common.markers import family
from services.capture.cameras.intrinsics import known_or_guessed
from services.label.exact import ExactLabels, Options, versions
from services.store.encode import Coding


@dataclass(frozen=True)
class Recipe:
    """Plain values, for worker processes. ``plain``: as ``Rig.as_plain()``; ``before``: the session's own objects.

    ``calibrations``: by camera, instead of what its labels say; ``source`` says in words where the rig is from.
    """

    source: str
    boxes: tuple[Box, ...]
    before: tuple[Box, ...]
    family: str
    folder: Path
    options: Options
    coding: Coding
    calibrations: Mapping[str, CameraLabel]
    plain: dict[str, Any]
    changes: tuple[str, ...]

    def labels(self) -> ExactLabels:
        """What labels frames by it."""
        return ExactLabels(self.boxes, family(self.family, self.folder), self.options)

    def camera(self, known: CameraLabel) -> CameraLabel:
        """A camera's label with the calibration that is to be used; raises CameraError if its size doesn't fit."""
        calibration = self.calibrations.get(known.name)
        if calibration is None:
            return known
        return known_or_guessed(known.name, calibration, known.width, known.height, known.serial)[0]

    def fingerprint(self) -> str:
        """Of all on which the new labels depend beside the samples, the versions that make them included."""
        content = {
            "rig": {key: self.plain.get(key) for key in ("markers", "objects", "pose", "inpaint", "record", "dataset")},
            "calibrations": {name: label.model_dump(mode="json") for name, label in sorted(self.calibrations.items())},
            "versions": versions(),
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def recipe_of(session: SessionFile, folder: Path, rig: Path | None, calibrations: Sequence[str]) -> Recipe:
    """By the rig file, else (None) by what the session itself says of its rig; ``calibrations`` as they were typed.

    Raises ConfigError for a rig or calibration file with mistakes, DatasetError for a ``session.json`` that
    describes its rig badly, RefusedError.
    """
    own = boxes_of(session, folder)
    cameras = dict(session.rig.get("cameras") or {})
    if rig is None:
        plain, boxes, base = dict(session.rig), own, Path()
        if "sha256" in (plain.get("markers") or {}):
            raise RefusedError(
                f"{folder.name} was recorded with a dictionary file of its own, which session.json doesn't hold; "
                "name the rig file that names it (--rig)",
                code="no_dictionary",
            )
        options, coding = _options(plain, folder)
        known, source = {}, "the session's own rig"
    else:
        loaded = load_rig(rig)
        plain, boxes, base = loaded.as_plain(), loaded.boxes, loaded.folder
        config = loaded.config
        options, coding = Options(config.pose, config.inpaint, config.record), Coding.of(config.dataset)
        known, source = dict(loaded.calibrations), str(rig)
        plain["cameras"] = {**cameras, **plain["cameras"]}
    known |= _calibrations(calibrations, session)
    for name, label in known.items():
        if name in plain["cameras"]:
            plain["cameras"][name] = {**plain["cameras"][name], "calibration": plain_calibration(label)}
    name = str((plain.get("markers") or {}).get("family"))
    changes = tuple(differences(session.rig, plain))
    return Recipe(source, boxes, own, name, base, options, coding, known, plain, changes)


def _options(plain: Mapping[str, Any], folder: Path) -> tuple[Options, Coding]:
    try:
        options = Options(
            PoseConfig.model_validate(plain.get("pose") or {}),
            InpaintConfig.model_validate(plain.get("inpaint") or {}),
            RecordConfig.model_validate(plain.get("record") or {}),
        )
        return options, Coding.of(DatasetConfig.model_validate(plain.get("dataset") or {}))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DatasetError(f"{folder / SESSION_FILE}: rig.{where}: {first['msg']}") from error


def _calibrations(typed: Sequence[str], session: SessionFile) -> dict[str, CameraLabel]:
    """``CAMERA=FILE``, or just ``FILE`` where the session has one camera."""
    found: dict[str, CameraLabel] = {}
    cameras = list(session.cameras) or list(session.rig.get("cameras") or {})
    for one in typed:
        name, equals, file = one.partition("=")
        if not equals:
            name, file = (cameras[0] if len(cameras) == 1 else ""), one
        if name not in cameras or name in found:
            known = ", ".join(cameras) or "none"
            raise ConfigError(f"--calibration {one}: say CAMERA=FILE, each camera once; the session has {known}")
        found[name] = read_calibration(Path(file), name)
    return found
