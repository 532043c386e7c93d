"""Calibration files in OpenCV's own formats, as a tree like that of a YAML file."""

from __future__ import annotations

import json
import math
from typing import Any

import cv2

from common.config.problems import FieldPath, Problems
from common.config.tree import Tree


def read_foreign(text: str, problems: Problems) -> Tree | None:
    """The tree of a FileStorage file (YAML, XML) or of JSON; None if it is neither, or after a noted problem."""
    begin = text.lstrip()[:200]
    if begin.startswith("{"):
        return _json(text, problems)
    if begin.startswith(("<?xml", "<opencv_storage", "%YAML:1.0")) or "!!opencv-matrix" in text:
        return _file_storage(text, problems)
    return None


def _json(text: str, problems: Problems) -> Tree | None:
    try:
        return _tree(json.loads(text), (), problems)
    except json.JSONDecodeError as error:
        problems.add(error.lineno, (), f"is no valid JSON at column {error.colno}: {error.msg}")
    except RecursionError:
        problems.add(0, (), "is nested too deeply; that is no calibration file")
    return None


def _file_storage(text: str, problems: Problems) -> Tree | None:
    storage = cv2.FileStorage()
    try:
        if not storage.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY):
            problems.add(0, (), "is no OpenCV FileStorage file; such a YAML file begins with %YAML:1.0")
            return None
        return _tree(_plain(storage.root()), (), problems)
    except (cv2.error, SystemError) as error:
        cause = error if isinstance(error, cv2.error) else error.__cause__ or error
        said = (str(getattr(cause, "err", "") or cause).strip() or "damaged").splitlines()[0]
        problems.add(0, (), f"OpenCV can't read it as a FileStorage file: {said}")
        return None
    finally:
        storage.release()


def _plain(node: cv2.FileNode) -> Any:
    """A FileStorage node as dicts, lists and scalars; a matrix as the list of its rows."""
    if node.isMap():
        keys = node.keys()
        if "data" in keys and "dt" in keys:
            matrix = node.mat()
            return None if matrix is None else matrix.tolist()
        return {key: _plain(node.getNode(key)) for key in keys}
    if node.isSeq():
        return [_plain(node.at(index)) for index in range(node.size())]
    if node.isInt():
        return int(node.real())
    if node.isReal():
        return float(node.real())
    return node.string() if node.isString() else None


def _tree(value: Any, path: FieldPath, problems: Problems) -> Tree:
    """Wrap plain values; these formats tell no lines."""
    if isinstance(value, dict):
        children = {str(key): _tree(child, (*path, str(key)), problems) for key, child in value.items()}
        return Tree(path, 0, children)
    if isinstance(value, list):
        return Tree(path, 0, [_tree(child, (*path, index), problems) for index, child in enumerate(value)])
    if isinstance(value, float) and not math.isfinite(value):
        problems.add(0, path, f"{value} is not allowed; it must be a finite number")
        return Tree(path, 0, 0.0)
    return Tree(path, 0, value if isinstance(value, str | int | float | bool) else None)
