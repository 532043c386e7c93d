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
from services.capture.cameras.base import Attached, Camera, Driver

ENTRY_POINTS = "tagmill.cameras"


@dataclass(frozen=True, slots=True)
class Entry:
    """Where a driver is (``module:attribute``) and what to do if its module can't be imported.

    ``attached``: where its ``attached() -> list[Attached]`` is (see ``Attached``); empty = in the driver's module, if
    that has one.
    """

    where: str
    cure: str
    attached: str = ""


BUILT_IN: dict[str, Entry] = {
    "synthetic": Entry(
        "services.capture.cameras.synthetic:SyntheticCamera", "install tagmill with its dependencies: make setup"
    ),
    "files": Entry("services.capture.cameras.files:FilesCamera", "install tagmill with its dependencies: make setup"),
    "kinect2": Entry(
        "services.capture.cameras.kinect2:Kinect2Camera",
        "install libfreenect2, then pip install 'tagmill[kinect2]', as docs/how-to/kinect-v2.md says",
    ),
    "stream": Entry(
        "services.capture.cameras.stream:StreamCamera", "install tagmill with its dependencies: make setup"
    ),
    "webcam": Entry(
        "services.capture.cameras.webcam:WebcamCamera", "the webcam driver needs Linux and tagmill's dependencies"
    ),
    "realsense": Entry("services.capture.cameras.realsense:RealSenseCamera", "pip install 'tagmill[realsense]'"),
}


def known_drivers() -> tuple[str, ...]:
    """Names of all drivers, built-in and of installed packages; none of them is imported."""
    return tuple(sorted({*BUILT_IN, *(point.name for point in _points())}))


def load_driver(name: str) -> Driver:
    """The driver's constructor; raises ConfigError for an unknown one, or one whose SDK is missing, with the cure."""
    entry = BUILT_IN.get(name)
    if entry is not None:
        return cast("Driver", _imported(name, lambda: _attribute(entry.where), entry.cure))
    for point in _points():
        if point.name == name:
            package = point.dist.name if point.dist else point.value.partition(":")[0]
            loaded = _imported(name, cast("Callable[[], object]", point.load), f"reinstall the package {package}")
            return cast("Driver", loaded)
    near = difflib.get_close_matches(name, known_drivers(), 1)
    hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known_drivers())}"
    raise ConfigError(
        f"unknown camera driver '{name}'; {hint} (further ones come from packages with an entry point '{ENTRY_POINTS}')"
    )


def load_attached(name: str) -> Callable[[], list[Attached]] | None:
    """The driver's search for attached cameras; None if it has none. Raises ConfigError as `load_driver` does."""
    entry = BUILT_IN.get(name)
    if entry is not None:
        module, _, attribute = (entry.attached or entry.where.partition(":")[0] + ":attached").partition(":")
        cure = entry.cure
    else:
        load_driver(name)  # an unknown or damaged one is told as there
        point = next(point for point in _points() if point.name == name)
        module, attribute, cure = point.module, "attached", f"reinstall the package that brings {point.module}"
    found = _imported(name, lambda: getattr(importlib.import_module(module), attribute, None), cure)
    return cast("Callable[[], list[Attached]] | None", found)


def open_camera(name: str, config: CameraConfig, rig: Rig) -> Camera:
    """Open camera ``name``; raises ConfigError or CameraError."""
    return load_driver(config.driver)(name, config, rig)


def _points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=ENTRY_POINTS))


def _attribute(where: str) -> object:
    module, _, attribute = where.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _imported(name: str, load: Callable[[], object], cure: str) -> object:
    try:
        return load()
    except ImportError as error:
        raise ConfigError(f"camera driver '{name}' can't be used: {error}; {cure}") from error
    except AttributeError as error:
        raise ConfigError(f"camera driver '{name}' is damaged: {error}; {cure}") from error
