"""One section of a rig file, whatever may be wrong with the others."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from common.config.problems import Problems
from common.config.section import Section
from common.config.tree import read_tree
from common.errors import ConfigError

Part = TypeVar("Part", bound=Section)


def read_part(path: Path, name: str, model: type[Part]) -> Part:
    """The section ``name`` of a rig file as its ``model``, with the model's defaults where the file has none.

    Whoever wants to stop a recording must not be kept from it by a mistake in an object that is being edited. Raises
    ConfigError if even that part can't be read.
    """
    problems = Problems(path)
    tree = read_tree(path, problems)
    if tree is None:
        problems.raise_if_any()
        raise ConfigError(f"{path}: is no rig file")
    found = tree.child(name)
    try:
        return model.model_validate((found.plain() if found is not None else None) or {})
    except ValidationError as error:
        raise ConfigError(f"{path}: {name} can't be read; 'tagmill check {path}' says what is wrong") from error
