"""What several formats share: the picture's file, text numbers, reading back."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from common.bounded import parse_json
from common.errors import DatasetError
from common.labels import Window
from tools.export.model import OutFile, Shot

Array = NDArray[np.float64]


def picture_file(shot: Shot, path: str) -> OutFile:
    """The shot's picture: linked where it is unchanged."""
    where, source = PurePosixPath(path), shot.source.picture
    assert shot.source.label.files is not None
    if shot.change.keeps:
        return OutFile(where, shot.key, link=source, size=shot.source.label.files.rgb.size)
    change = shot.change
    return OutFile(where, shot.key, make=lambda: change.colour(source), size=change.guess_bytes())


def number(value: float) -> str:
    """Six digits after the point at most: a thousandth of a pixel in a normalised coordinate."""
    return f"{value:.6f}".rstrip("0").rstrip(".") if value else "0"


def unit(window: Window, shot: Shot) -> tuple[float, float, float, float]:
    """A window's edges x_min, y_min, x_max, y_max as shares of the picture, whose own edges are 0 and 1."""
    x = [(value + 0.5) / shot.camera.width for value in (window.x_min, window.x_max)]
    y = [(value + 0.5) / shot.camera.height for value in (window.y_min, window.y_max)]
    return x[0], y[0], x[1], y[1]


def shares(pixels: Array, shot: Shot) -> Array:
    """Pixels (N, 2) as shares of the picture."""
    return np.asarray((pixels + 0.5) / np.array([shot.camera.width, shot.camera.height]))


def pixels_of(unit_points: Array, shot: Shot) -> Array:
    """The way back."""
    return np.asarray(unit_points * np.array([shot.camera.width, shot.camera.height]) - 0.5)


def as_array(window: Window) -> Array:
    """x_min y_min x_max y_max."""
    return np.array([window.x_min, window.y_min, window.x_max, window.y_max])


def read_text(path: Path) -> str:
    """A file of an export; raises DatasetError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path} can't be read back: {error}") from error


def read_json(path: Path) -> Any:
    """A JSON file of an export; raises DatasetError."""
    try:
        return parse_json(read_text(path))
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON: {error}") from error


def json_text(plain: Any) -> str:
    """As exports write JSON: one line, no NaN."""
    return json.dumps(plain, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"
