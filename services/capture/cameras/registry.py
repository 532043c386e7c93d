"""The table of drivers. Nothing is imported before it is asked for, so a missing SDK costs only its own camera."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import cast

from common.config import Rig
from common.config.models import CameraConfig
from common.errors import ConfigError
from services.capture.cameras.base import Camera, Driver

ENTRY_POINTS = "tagmill.cameras"


@dataclass(frozen=True, slots=True)
class Entry:
    """Where a driver is (``module:attribute``) and what to do if its module can't be imported."""

    where: str
    cure: str


BUILT_IN: dict[str, Entry] = {
    "synthetic": Entry(
        "services.capture.cameras.synthetic:SyntheticCamera", "install tagmill with its dependencies: make setup"
    ),
    "files": Entry("services.capture.cameras.files:FilesCamera", "install tagmill with its dependencies: make setup"),
}


def known_drivers() -> tuple[str, ...]:
    """Names of all drivers, built-in and of installed packages; none of them is imported."""
    return tuple(sorted({*BUILT_IN, *(point.name for point in _points())}))


def load_driver(name: str) -> Driver:
    """The driver's constructor; raises ConfigError for an unknown one, or one whose SDK is missing, with the cure."""
    entry = BUILT_IN.get(name)
    if entry is not None:
        return _imported(name, lambda: _attribute(entry.where), entry.cure)
    for point in _points():
        if point.name == name:
            package = point.dist.name if point.dist else point.value.partition(":")[0]
            return _imported(name, cast("Callable[[], object]", point.load), f"reinstall the package {package}")
    near = difflib.get_close_matches(name, known_drivers(), 1)
    hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known_drivers())}"
    raise ConfigError(
        f"unknown camera driver '{name}'; {hint} (further ones come from packages with an entry point '{ENTRY_POINTS}')"
    )


def open_camera(name: str, config: CameraConfig, rig: Rig) -> Camera:
    """Open camera ``name``; raises ConfigError or CameraError."""
    return load_driver(config.driver)(name, config, rig)


def _points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=ENTRY_POINTS))


def _attribute(where: str) -> object:
    module, _, attribute = where.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _imported(name: str, load: Callable[[], object], cure: str) -> Driver:
    try:
        return cast("Driver", load())
    except ImportError as error:
        raise ConfigError(f"camera driver '{name}' can't be used: {error}; {cure}") from error
    except AttributeError as error:
        raise ConfigError(f"camera driver '{name}' is damaged: {error}; {cure}") from error
