"""The table of formats. None is imported before it is asked for; further ones come from installed packages."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import cast

from common.errors import ConfigError, RefusedError
from tools.export.model import Exporter

ENTRY_POINTS = "tagmill.exporters"

BUILT_IN = {
    "yolo": "tools.export.formats.yolo:Yolo",
    "yolo-pose": "tools.export.formats.yolo:YoloPose",
    "yolo-obb": "tools.export.formats.yolo:YoloObb",
    "yolo-segment": "tools.export.formats.yolo:YoloSegment",
    "coco": "tools.export.formats.coco:Coco",
    "bop": "tools.export.formats.bop:Bop",
    "kitti": "tools.export.formats.kitti:Kitti",
    "singleshotpose": "tools.export.formats.singleshotpose:SingleShotPose",
    "dope": "tools.export.formats.dope:Dope",
}
"""Name to ``module:attribute``."""


def known_formats() -> tuple[str, ...]:
    """Names of all formats, built-in ones first; none of them is imported."""
    return (*BUILT_IN, *sorted({point.name for point in _points()} - BUILT_IN.keys()))


def load_exporter(name: str) -> Exporter:
    """The exporter of a format; raises RefusedError for an unknown one, ConfigError for one that can't be loaded."""
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        return cast("Callable[[], Exporter]", getattr(importlib.import_module(module), attribute))()
    for point in _points():
        if point.name == name:
            package = point.dist.name if point.dist else point.value.partition(":")[0]
            try:
                return cast("Callable[[], Exporter]", point.load())()
            except (ImportError, AttributeError) as error:
                raise ConfigError(f"format '{name}' can't be used: {error}; reinstall the package {package}") from error
    near = difflib.get_close_matches(name, known_formats(), 1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise RefusedError(
        f"unknown format '{name}'; {hint}known are {', '.join(known_formats())} (further ones come from packages with "
        f"an entry point '{ENTRY_POINTS}')",
        code="refused",
    )


def _points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=ENTRY_POINTS))
