"""Distances on somebody's own pictures: read what was measured, label the pictures, put both side by side."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from common.config import Rig, load_rig
from common.errors import ConfigError
from common.geometry import CameraModel
from common.labels import CameraLabel, SideLabel
from common.markers import family
from tools.evaluate.chain import Chain
from tools.evaluate.spread import Spread, spread

COLUMNS = ("picture", "marker", "real mm", "estimate", "difference", "kind of corners", "remark")


class Truth(BaseModel):
    """A picture and the distance from the camera to the middle of its marker (``marker``: which, if several)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str = Field(min_length=1)
    distance_mm: float = Field(gt=0, allow_inf_nan=False)
    marker: int | None = Field(default=None, ge=0)


@dataclass(frozen=True)
class Measured:
    """A picture's estimate; where there is none, ``remark`` says why."""

    file: str
    real_mm: float
    marker: int | None = None
    estimate_mm: float | None = None
    kind: str | None = None
    remark: str = ""

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return dict(vars(self))

    def cells(self) -> list[str]:
        """For a table with ``COLUMNS``."""
        marker = "-" if self.marker is None else str(self.marker)
        if self.estimate_mm is None:
            return [self.file, marker, f"{self.real_mm:g}", "-", "-", "-", self.remark]
        difference = self.estimate_mm - self.real_mm
        return [
            self.file, marker, f"{self.real_mm:g}", f"{self.estimate_mm:.2f}", f"{difference:+.2f}",
            self.kind or "-", self.remark,
        ]  # fmt: skip


def measure(folder: Path, truth: Path, rig_file: Path, camera: str | None) -> list[Measured]:
    """Label every picture of the truth file; raises ConfigError naming all that can't be read."""
    rig = load_rig(rig_file)
    calibration = _calibration(rig, camera)
    known = read_truth(truth)
    problems = [
        f"{truth}: there is no picture {folder / row.file}" for row in known if not (folder / row.file).is_file()
    ]
    if problems:
        raise ConfigError(f"{len(problems)} of the pictures in {truth} are missing; look at --folder", tuple(problems))
    markers = family(rig.config.markers.family, rig.folder)
    chain = Chain(rig.boxes, markers, CameraModel.from_label(calibration), rig.folder)
    return [_measured(folder, row, calibration, chain) for row in known]


def by_distance(pictures: Sequence[Measured]) -> list[Spread]:
    """One row a real distance, nearest first."""
    rows = []
    for real in sorted({picture.real_mm for picture in pictures}):
        of_it = [picture for picture in pictures if picture.real_mm == real]
        errors = [picture.estimate_mm - real for picture in of_it if picture.estimate_mm is not None]
        rows.append(spread(real, errors, len(of_it)))
    return rows


def read_truth(path: Path) -> list[Truth]:
    """CSV with a head line, or YAML: a list of maps. Raises ConfigError with all mistakes."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} can't be read ({error}); it says the distances: a CSV file with the columns file,distance_mm"
        ) from error
    try:
        rows = _rows(path, text)
        return TypeAdapter(list[Truth]).validate_python(rows)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path} is no valid YAML: {error}") from error
    except ValidationError as error:
        problems = tuple(
            f"{path}: entry {mistake['loc'][0] if mistake['loc'] else '-'}"
            f"{''.join(f', {part}' for part in mistake['loc'][1:])}: {mistake['msg']}"
            for mistake in error.errors()
        )
        raise ConfigError(f"{path} is no list of pictures with file and distance_mm", problems) from error


def _rows(path: Path, text: str) -> Any:
    if path.suffix.lower() in {".yaml", ".yml"}:
        return yaml.safe_load(text)
    lines = csv.DictReader(text.splitlines(), skipinitialspace=True)
    return [{str(key): value for key, value in line.items() if value not in (None, "")} for line in lines]


def _calibration(rig: Rig, camera: str | None) -> CameraLabel:
    name = camera if camera is not None else next(iter(rig.config.cameras), None)
    if name is None:
        raise ConfigError(f"{rig.path}: there is no camera; give one with a calibration file")
    rig.camera(name)
    found = rig.calibration(name)
    if found is None:
        raise ConfigError(f"{rig.path}: cameras.{name} has no calibration, and a distance can't be had without one")
    return found


def _measured(folder: Path, row: Truth, calibration: CameraLabel, chain: Chain) -> Measured:
    picture = cv2.imread(str(folder / row.file), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        return Measured(row.file, row.distance_mm, row.marker, remark="is no picture that OpenCV can read")
    height, width = picture.shape
    if (width, height) != (calibration.width, calibration.height):
        remark = f"is {width}x{height}, the calibration is for {calibration.width}x{calibration.height}"
        return Measured(row.file, row.distance_mm, row.marker, remark=remark)
    sides = [side for label in chain.label(np.asarray(picture, dtype=np.uint8)) for side in label.sides]
    found = [side for side in sides if row.marker in (None, side.marker)]
    if len(found) == 1:
        side = found[0]
        return Measured(row.file, row.distance_mm, side.marker, side.distance_mm, side.corners_kind)
    return Measured(row.file, row.distance_mm, row.marker, remark=_why_not(row, sides))


def _why_not(row: Truth, sides: Sequence[SideLabel]) -> str:
    if not sides:
        return "no marker of the rig was found"
    seen = ", ".join(str(side.marker) for side in sides)
    if row.marker is None:
        return f"shows markers {seen}: say which in the column 'marker'"
    return f"marker {row.marker} was not found (but {seen})"
