"""Where cameras stand to each other: a file that `calibrate extrinsics` writes and ``extrinsics:`` in a rig names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field, RootModel

from common.config.problems import Problems
from common.config.schema import read_model
from common.config.section import Section
from common.config.tree import read_tree
from common.config.whole_file import write_whole
from common.errors import ConfigError

WHAT = "extrinsics file"
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3)]
_HEAD = """\
# Where cameras stand to each other, by `tagmill calibrate extrinsics`. A point x (mm) in a camera's frame is
# R(rvec) x + tvec_mm in that of the camera `to`. sd: standard deviations, about and along the axes of `to`.
"""


class Extrinsics(Section):
    """A camera's frame in another's: ``rvec`` (rad) and ``tvec_mm`` turn points of this camera into those of ``to``.

    ``sd_rotation_deg``, ``sd_mm``: about and along the axes of ``to``; from ``pairs`` of pictures, ``rms_px``.
    ``serials``: which cameras they were, where they told.
    """

    to: str
    rvec: Vector
    tvec_mm: Vector
    sd_rotation_deg: Vector
    sd_mm: Vector
    pairs: Annotated[int, Field(ge=1)]
    rms_px: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    serials: dict[str, str] = {}


class _File(RootModel[dict[str, Extrinsics]]):
    """Camera to where it stands."""


def read_extrinsics(path: Path) -> dict[str, Extrinsics]:
    """By camera. Raises ConfigError with every mistake as ``file:line: field: reason``."""
    problems = Problems(path)
    tree = read_tree(path, problems, WHAT)
    found = None if tree is None else read_model(tree, problems, _File)
    if found is not None:
        for name, one in found.root.items():
            if one.to == name:
                problems.add(0, (name, "to"), "is the camera itself")
    problems.raise_if_any()
    return {} if found is None else found.root


def write_extrinsics(path: Path, cameras: Mapping[str, Extrinsics]) -> None:
    """Write the file, whole or not at all. Raises ConfigError."""
    document = {name: one.model_dump(mode="json") for name, one in cameras.items()}
    text = _HEAD + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)
    cure = "choose another place with --out"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{path} can't be written: {error.strerror}; {cure}") from error
    write_whole(path, text, cure)
