"""The rig: a checked ``rig.yaml`` with everything that its services need resolved."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from common.config.addresses import presentable
from common.config.calibration import read_calibration, same_shape
from common.config.differences import plain_calibration, plain_family, plain_objects
from common.config.extrinsics import Extrinsics, read_extrinsics
from common.config.models import DRIVER_OPTIONS, CameraConfig, RigConfig
from common.config.objects import ObjectReader
from common.config.problems import Problems, suggestion
from common.config.schema import check_options, read_schema
from common.config.surroundings import check_dataset_root, check_driver, check_inputs, check_network, unwritable
from common.config.tree import Tree, read_tree
from common.errors import ConfigError
from common.geometry import Box
from common.labels import CameraLabel
from common.markers import Family, family


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig that holds together.

    ``config`` is the file as written (paths relative to ``folder``), ``boxes`` its objects, ``dataset_root`` absolute,
    ``warnings`` what is allowed but hardly meant, ``extrinsics`` where cameras stand to others. Two rigs are equal, and
    hash alike, if their content is: configuration and calibrations, wherever the files lie.
    """

    path: Path
    folder: Path
    config: RigConfig
    boxes: tuple[Box, ...]
    dataset_root: Path
    calibrations: Mapping[str, CameraLabel]
    warnings: tuple[str, ...] = ()
    extrinsics: Mapping[str, Extrinsics] = field(default_factory=dict)

    def resolve(self, path: Path) -> Path:
        """A path of the rig file, absolute and without ``..``."""
        return (self.folder / path).resolve()

    def camera(self, name: str) -> CameraConfig:
        """A camera of the rig; raises ConfigError that names the known ones."""
        if name in self.config.cameras:
            return self.config.cameras[name]
        known = ", ".join(self.config.cameras) or "none"
        hint = suggestion(name, self.config.cameras)
        raise ConfigError(f"{self.path}: there is no camera '{name}'{hint}; known are {known}", ())

    def calibration(self, name: str) -> CameraLabel | None:
        """The intrinsics from the camera's calibration file, None if the rig names none (or no such camera)."""
        return self.calibrations.get(name)

    def with_camera_file(self, path: Path) -> Rig:
        """This rig and the cameras of a further file (``cameras: {cam1: {...}}``, paths relative to that file).

        Raises ConfigError with all its mistakes, also for a camera that the rig has already.
        """
        problems = Problems(path)
        tree = read_tree(path, problems, "camera file")
        if tree is None:
            problems.raise_if_any()
            raise ConfigError(f"{path}: is no camera file")
        _refuse_other_sections(tree, problems)
        config = read_schema(tree, problems)
        calibrations = _check_cameras(tree, config, path.parent, problems)
        for name in config.cameras:
            if name in self.config.cameras:
                found = tree.nearest(("cameras", name))
                problems.add(found.line, found.path, f"the rig {self.path} has a camera '{name}' already")
        if not config.cameras and not problems.found:
            problems.add(0, ("cameras",), "is missing; a camera file adds at least one camera")
        problems.raise_if_any()
        added = {name: _absolute(camera, path.parent) for name, camera in config.cameras.items()}
        cameras = {**self.config.cameras, **added}
        return replace(
            self,
            config=self.config.model_copy(update={"cameras": cameras}),
            calibrations={**self.calibrations, **calibrations},
        )

    def as_plain(self) -> dict[str, Any]:
        """What a label depends on, JSON-able and normalised, for session.json and ``differences``.

        ``{"markers": ..., "objects": {name: ...}, "cameras": {name: {..., "calibration": content or None}},
        "pose": ..., "inpaint": ..., "record": {"incomplete": ...}, "dataset": {"format": ..., "quality": ...}}``
        """
        cameras = {
            name: {
                **presentable(camera.model_dump(mode="json", exclude={"calibration"})),
                "calibration": plain_calibration(self.calibrations.get(name)),
            }
            for name, camera in self.config.cameras.items()
        }
        return {
            "markers": plain_family(self._family_name(), self.folder),
            "objects": plain_objects(self.boxes),
            "cameras": cameras,
            "pose": self.config.pose.model_dump(mode="json"),
            "inpaint": self.config.inpaint.model_dump(mode="json"),
            "record": {"incomplete": self.config.record.incomplete},
            "dataset": self.config.dataset.model_dump(mode="json", include={"format", "quality"}),
        }

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 (hex) of the whole content: configuration, calibrations, custom dictionary."""
        content = {"plain": self.as_plain(), "config": self.config.model_dump(mode="json", exclude={"cameras"})}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rig) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def _family_name(self) -> str:
        return family(self.config.markers.family, self.folder).name


def load_rig(path: Path, *, inputs: bool = False, cameras: bool = True) -> Rig:
    """Read and check a rig file.

    With ``inputs`` also that the pictures and videos of its cameras are there and that the dataset can be written:
    what ``check`` and ``up`` want to know, while a running service leaves that to the one concerned. Without
    ``cameras`` the section is left out, mistakes and all: markers are printed before a camera is calibrated.
    Raises ConfigError whose ``problems`` are all mistakes, each ``file:line: field: reason``.
    """
    path = Path(path)
    problems = Problems(path)
    tree = read_tree(path, problems)
    if tree is None:
        problems.raise_if_any()
        raise ConfigError(f"{path}: is no rig file")
    if not cameras:
        tree.remove(("cameras",))
    folder = path.parent.absolute()
    config = read_schema(tree, problems)
    boxes = ObjectReader(tree, _family(tree, config, folder, problems), problems).read(config)
    calibrations = _check_cameras(tree, config, folder, problems, inputs=inputs)
    extrinsics = _extrinsics(tree, config, folder, problems)
    check_network(tree, config.network, folder, problems)
    root = (folder / config.dataset.root).resolve()
    check_dataset_root(tree, root, problems)
    problems.raise_if_any()
    warnings = [] if config.objects else [f"{path}: objects: there are none, so no frame can be labelled"]
    strange = sorted({*extrinsics, *(one.to for one in extrinsics.values())} - set(config.cameras))
    warnings += [f"{path}: extrinsics: {config.extrinsics} names {name}, no camera of this rig" for name in strange]
    if inputs and (why := unwritable(root)):
        warnings.append(why)
    return Rig(path, folder, config, boxes, root, calibrations, tuple(warnings), extrinsics)


def _family(tree: Tree, config: RigConfig, folder: Path, problems: Problems) -> Family | None:
    if problems.touch(("markers",)):
        return None  # the family is unknown, not the default one
    try:
        return family(config.markers.family, folder)
    except ConfigError as error:
        found = tree.nearest(("markers", "family"))
        problems.add(found.line, ("markers", "family"), error.message)
        return None


def _check_cameras(
    tree: Tree, config: RigConfig, folder: Path, problems: Problems, *, inputs: bool = False
) -> dict[str, CameraLabel]:
    """Note what is wrong with cameras; returns the calibrations by camera."""
    calibrations: dict[str, CameraLabel] = {}
    for name, camera in config.cameras.items():
        check_driver(tree, name, camera, problems)
        check_options(tree, name, camera, problems)
        if inputs and not problems.touch(("cameras", name)):
            check_inputs(tree, name, camera, folder, problems)
        if camera.calibration is not None:
            label = _calibration(tree, name, camera, folder, problems)
            if label is not None:
                calibrations[name] = label
    return calibrations


def _calibration(tree: Tree, name: str, camera: CameraConfig, folder: Path, problems: Problems) -> CameraLabel | None:
    """A camera's calibration; its own mistakes are told at the key that names the file."""
    found = tree.nearest(("cameras", name, "calibration"))
    size = (camera.width, camera.height) if camera.width and camera.height else None
    assert camera.calibration is not None
    try:
        label = read_calibration(folder / camera.calibration, name, (size[0], size[1]) if size else None)
    except ConfigError as error:
        for line in error.problems:
            problems.add(found.line, found.path, line)
        return None
    if size is not None and same_shape(label, size[0] or 0, size[1] or 0):
        return label  # scaled by the camera's process, which says so
    for key, wanted, given in (("width", camera.width, label.width), ("height", camera.height, label.height)):
        if wanted is not None and wanted != given:
            at = tree.nearest(("cameras", name, key))
            reason = f"{wanted}, but the calibration {camera.calibration} is for {label.width} x {label.height} pixels"
            problems.add(at.line, at.path, reason)
    return label


def _extrinsics(tree: Tree, config: RigConfig, folder: Path, problems: Problems) -> dict[str, Extrinsics]:
    """Where cameras stand; mistakes are told at the key that names the file."""
    if config.extrinsics is None:
        return {}
    found = tree.nearest(("extrinsics",))
    try:
        read = read_extrinsics(folder / config.extrinsics)
    except ConfigError as error:
        for line in error.problems:
            problems.add(found.line, ("extrinsics",), line)
        return {}
    return read


def _refuse_other_sections(tree: Tree, problems: Problems) -> None:
    sections = list(tree.value) if isinstance(tree.value, dict) else []
    for key in sections:
        found = tree.child(key)
        if key != "cameras" and key in RigConfig.model_fields and found is not None:
            problems.add(found.line, found.path, "belongs to the rig file; a camera file has cameras only")


def _absolute(camera: CameraConfig, folder: Path) -> CameraConfig:
    """A camera of another file: its paths made absolute, since the rig's folder is not theirs."""
    changed: dict[str, Any] = {}
    if camera.calibration is not None:
        changed["calibration"] = (folder / camera.calibration).resolve()
    model = DRIVER_OPTIONS.get(camera.driver)
    if model is not None:
        options = model.model_validate(camera.options)
        for key in camera.options:
            value = getattr(options, key)
            if isinstance(value, Path):
                changed[key] = str((folder / value).resolve())
    return CameraConfig.model_validate({**camera.model_dump(), **changed})
