"""Calibration files in OpenCV's own formats and in JSON, as a tree like that of a YAML file."""

from __future__ import annotations

import json
import math
from typing import Any

from common.bounded import parse_json
from common.config.problems import FieldPath, Problems
from common.config.tree import CONTROL, MAX_DEPTH, MAX_VALUES, Tree
from common.file_storage import is_file_storage, parse_file_storage


def read_foreign(text: str, problems: Problems) -> Tree | None:
    """The tree of a FileStorage file (YAML, XML) or of JSON; None if it is neither, or after a noted problem."""
    if text.lstrip()[:1] == "{":
        return _json(text, problems)
    if is_file_storage(text):
        return _file_storage(text, problems)
    return None


def _json(text: str, problems: Problems) -> Tree | None:
    try:
        return _Wrapper(problems).tree(parse_json(text), ())
    except json.JSONDecodeError as error:
        problems.add(error.lineno, (), f"is no valid JSON at column {error.colno}: {error.msg}")
    except ValueError as error:
        problems.add(0, (), f"is no calibration file: {error}")
    return None


def _file_storage(text: str, problems: Problems) -> Tree | None:
    try:
        return _Wrapper(problems).tree(parse_file_storage(text), ())
    except ValueError as error:
        problems.add(0, (), f"can't be read as an OpenCV FileStorage file: {error}")
        return None


class _Wrapper:
    """Wraps plain values, within the limits of a YAML file's; these formats tell no lines."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._values = 0

    def tree(self, value: Any, path: FieldPath) -> Tree:
        """Raises ValueError beyond the limits; a number that isn't finite is noted."""
        self._values += 1
        if self._values > MAX_VALUES or len(path) > MAX_DEPTH:
            raise ValueError(f"it has more than {MAX_VALUES} values or is nested too deeply")
        if isinstance(value, dict):
            return Tree(path, 0, {key: self.tree(child, (*path, key)) for key, child in value.items()})
        if isinstance(value, list):
            return Tree(path, 0, [self.tree(child, (*path, index)) for index, child in enumerate(value)])
        if isinstance(value, str) and CONTROL.search(value):
            self._problems.add(0, path, f"{value!r} contains a control character; remove it")
            return Tree(path, 0, "")
        if isinstance(value, int | float) and not _is_finite(value):
            self._problems.add(0, path, f"{str(value)[:20]} is not allowed; it must be a finite number")
            return Tree(path, 0, 0.0)
        return Tree(path, 0, value if isinstance(value, str | int | float | bool) else None)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False
