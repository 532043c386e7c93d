"""Calibration files: tagmill's plain YAML, OpenCV's FileStorage (yml, xml, json), ROS camera_info.

All three come down to picture size, camera matrix and distortion; ``read_calibration`` finds out which it is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from common.config.foreign import read_foreign
from common.config.problems import FieldPath, Problems, suggestion
from common.config.schema import shown
from common.config.tree import Tree, parse_tree, read_text
from common.config.whole_file import write_whole
from common.errors import ConfigError
from common.labels import CameraLabel

Model = Literal["pinhole", "fisheye"]
WHAT = "calibration file"
PINHOLE_LENGTHS = (0, 4, 5, 8, 12, 14)
FISHEYE_LENGTH = 4
SAME_ASPECT = 0.005
"""Two aspect ratios are the same if they differ by no more than this share (sizes are whole pixels)."""

# What the formats call the same thing; tagmill's own name first. FileStorage has no fixed names: these are
# those of OpenCV's calibration samples and tools, and of ROS camera_info in both its spellings.
WIDTH = ("width", "image_width", "image_Width")
HEIGHT = ("height", "image_height", "image_Height")
SIZE = ("cameraResolution", "image_size")
MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "camera_Matrix", "K", "k", "M1")
DISTORTION = (
    "distortion", "distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D", "d", "D1",
)  # fmt: skip
MODEL = ("model", "distortion_model", "fisheye_model")
_MODELS: dict[str, Model] = {
    "pinhole": "pinhole",
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "0": "pinhole",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
    "1": "fisheye",
}


def read_calibration(path: Path, camera: str, size: tuple[int, int] | None = None) -> CameraLabel:
    """The intrinsics that a calibration file holds.

    ``size`` (width, height) stands in where the file names no picture size, as OpenCV's stereo files don't.
    Raises ConfigError with every mistake as ``file:line: field: reason``.
    """
    problems = Problems(path)
    text = read_text(path, problems, WHAT)
    tree: Tree | None = None
    if text is not None:
        foreign = read_foreign(text, problems)
        tree = parse_tree(text, problems, WHAT) if foreign is None and not problems.found else foreign
    problems.raise_if_any()
    if tree is None:
        raise ConfigError(f"{path}: is no calibration file")
    label = _Calibration(tree, problems).label(camera, size)
    problems.raise_if_any()
    return label


def same_shape(calibration: CameraLabel, width: int, height: int) -> bool:
    """Whether pictures of this size may be scaled ones of those calibrated: cut ones have another aspect ratio."""
    across, down = width / calibration.width, height / calibration.height
    return down > 0 and abs(across / down - 1) <= SAME_ASPECT


def write_calibration(path: Path, camera: CameraLabel, quality: Mapping[str, Any] | None = None) -> None:
    """Write plain YAML, whole or not at all. ``quality``: what the calibration knows about its own quality."""
    document: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "model": camera.model,
        "camera_matrix": [list(row) for row in camera.matrix],
        "distortion": list(camera.distortion),
    }
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    if camera.serial is not None:
        # Always quoted: PyYAML leaves 0815 bare, and readers of YAML 1.2 make the number 815 of it.
        text += f"serial: {json.dumps(camera.serial, ensure_ascii=False)}\n"
    if quality:
        own = {"quality": dict(quality)}
        text += yaml.safe_dump(own, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
    write_whole(path, text, "choose another place")


class _Calibration:
    """Finds the values under their several names and notes what is wrong with them."""

    def __init__(self, tree: Tree, problems: Problems) -> None:
        self._tree = tree
        self._problems = problems

    def label(self, camera: str, size: tuple[int, int] | None) -> CameraLabel:
        """The intrinsics; meaningless once a problem was noted."""
        width, height = self._size(size)
        model = self._model()
        matrix = self._matrix(None if self._problems.found else (width, height))
        distortion = self._distortion(model)
        serial = self._tree.child("serial")
        rows = [tuple(float(value) for value in row) for row in matrix]
        return CameraLabel.model_validate(
            {
                "name": camera,
                "width": width,
                "height": height,
                "matrix": rows,
                "distortion": tuple(float(value) for value in distortion),
                "model": model,
                "intrinsics_from": "calibration",
                "serial": None if serial is None or serial.value is None else str(serial.value),
            }
        )

    def _find(self, names: tuple[str, ...]) -> Tree | None:
        return next((found for name in names if (found := self._tree.child(name)) is not None), None)

    def _note(self, at: Tree, reason: str) -> None:
        self._problems.add(at.line, at.path, reason)

    def _missing(self, names: tuple[str, ...], what: str) -> None:
        keys = list(self._tree.value) if isinstance(self._tree.value, dict) else []
        near = next((hint for key in keys if (hint := suggestion(key, names[:1]))), "")
        found = f" (there is '{keys[_nearest(keys, names[0])]}')" if near and keys else ""
        path: FieldPath = (names[0],)
        self._problems.add(0, path, f"is missing{found}; a calibration file needs {what}")

    def _size(self, fallback: tuple[int, int] | None) -> tuple[int, int]:
        both = self._find(SIZE)
        if both is not None:
            pair = _numbers(both)
            if pair is not None and len(pair) == 2 and all(_is_length(value) for value in pair):
                return int(pair[0]), int(pair[1])
        sides: list[int] = []
        for names in (WIDTH, HEIGHT):
            found = self._find(names)
            if found is None:
                if fallback is None:
                    self._missing(names, "the size of the pictures it was made from, in pixels")
                continue
            if isinstance(found.value, bool) or not isinstance(found.value, int | float) or not _is_length(found.value):
                self._note(found, f"must be a whole number of pixels from 1 to 65535, not {shown(found.plain())}")
                continue
            sides.append(int(found.value))
        if len(sides) == 2:
            return sides[0], sides[1]
        return fallback or (1, 1)

    def _model(self) -> Model:
        found = self._find(MODEL)
        if found is None:
            return "pinhole"
        model = _MODELS.get(str(found.plain()))
        if model is None:
            known = "pinhole, fisheye (ROS: plumb_bob, rational_polynomial, equidistant)"
            self._note(found, f"{shown(found.plain())} is not known; one of {known}")
        return model or "pinhole"

    def _matrix(self, size: tuple[int, int] | None) -> np.ndarray[Any, np.dtype[np.float64]]:
        found = self._find(MATRIX)
        if found is None:
            self._missing(MATRIX, "the 3x3 matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
            return np.eye(3)
        numbers = _numbers(found)
        if numbers is None or len(numbers) != 9:
            self._note(found, "must be 3x3 finite numbers, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
            return np.eye(3)
        matrix = np.array(numbers).reshape(3, 3)
        reason = _matrix_fault(matrix, size)
        if reason:
            self._note(found, reason)
        return matrix

    def _distortion(self, model: Model) -> list[float]:
        found = self._find(DISTORTION)
        if found is None:
            self._missing(DISTORTION, "the coefficients k1, k2, p1, p2, k3 ... (an empty list: none)")
            return []
        numbers = _numbers(found)
        if numbers is None:
            self._note(found, "must be a list of finite numbers k1, k2, p1, p2, k3, ...")
            return []
        if model == "fisheye" and len(numbers) != FISHEYE_LENGTH:
            self._note(found, f"has {len(numbers)} values; a fisheye has the 4 coefficients k1 to k4")
        elif model == "pinhole" and len(numbers) not in PINHOLE_LENGTHS:
            lengths = ", ".join(str(length) for length in PINHOLE_LENGTHS)
            self._note(found, f"has {len(numbers)} values; OpenCV knows {lengths}")
        return numbers


def _matrix_fault(matrix: np.ndarray[Any, np.dtype[np.float64]], size: tuple[int, int] | None) -> str:
    """What makes a matrix no camera's (at a picture of ``size``, if that is known), empty if it is one."""
    fx, fy = matrix[0, 0], matrix[1, 1]
    if fx <= 0 or fy <= 0:
        return f"fx and fy must be greater than 0, not {fx:g} and {fy:g}"
    if not np.allclose(matrix[2], [0, 0, 1]) or abs(matrix[1, 0]) > 1e-9:
        return "must read [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; is it transposed?"
    if abs(matrix[0, 1]) > 1e-6 * fx:
        return f"has a skew of {matrix[0, 1]:g}; OpenCV's camera model has none, so calibrate without it"
    if size is None:
        return ""
    (cx, cy), (width, height) = matrix[:2, 2], size
    if not (-width <= cx <= 2 * width and -height <= cy <= 2 * height):
        return f"its centre ({cx:g}, {cy:g}) is far outside a picture of {width} x {height}; do size and matrix match?"
    return ""


def _is_length(value: float) -> bool:
    return float(value).is_integer() and 1 <= value <= 65535


def _nearest(keys: list[str], name: str) -> int:
    return next(index for index, key in enumerate(keys) if suggestion(key, (name,)))


def _numbers(at: Tree) -> list[float] | None:
    """All numbers of a list, of a list of lists or of a matrix map (``data``), row by row; None if others are in it."""
    if isinstance(at.value, dict):
        data = at.child("data")
        return None if data is None else _numbers(data)
    if not isinstance(at.value, list):
        return None
    out: list[float] = []
    for item in at.value:
        if isinstance(item.value, list):
            inner = _numbers(item)
            if inner is None:
                return None
            out += inner
        elif isinstance(item.value, bool) or not isinstance(item.value, int | float):
            return None
        else:
            out.append(float(item.value))
    return out
