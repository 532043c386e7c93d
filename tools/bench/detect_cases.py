"""What `bench detect` looks at: rendered scenes, photographs with known markers, pictures without any."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from common.errors import ConfigError
from common.markers import Family, family
from tools.bench import marker_scenes

Grey = NDArray[np.uint8]
Corners = NDArray[np.float64]

REFERENCE = "reference scenes"
EMPTY = "marker-free"
SEARCHED = "apriltag_36h11"
PICTURES = {".jpg", ".jpeg", ".png"}
LOOK_ALIKES = ("apriltag_25h9", "apriltag_36h10", "aruco_mip_36h12", "6x6_250", "5x5_1000", "apriltag_16h5")
CROP = (320, 240)
VIDEO, VIDEO_STEP = "wpical/charuco_12x8.mp4", 12
CHESSBOARDS = ("opencv/chess", "boofcv/sony_chess", "boofcv/kinect_basket")


@dataclass(frozen=True)
class TrueMarker:
    """A marker that is there: id, corners (4, 2) px TL TR BR BL or None, centre (2,) px or None."""

    id: int
    corners: Corners | None
    centre: Corners | None


@dataclass(frozen=True)
class Case:
    """A picture with its truth; ``row`` is the table's row that it belongs to."""

    row: str
    grey: Grey
    family: Family
    markers: tuple[TrueMarker, ...]
    rendered: bool = False


def rendered(seed: int, scenes: int) -> Iterator[Case]:
    """The reference scenes, then ``scenes`` of each difficulty."""
    searched = family(SEARCHED, Path())
    for scene in marker_scenes.reference(searched, seed):
        yield _case(REFERENCE, scene, searched)
    for row, scene in marker_scenes.rows(searched, seed, scenes):
        yield _case(row, scene, searched)


def photographs(data: Path) -> tuple[list[Case], list[str]]:
    """The pictures of ``data/truth.json`` and the names of those that aren't there; raises ConfigError."""
    truth = data / "truth.json"
    if not truth.is_file():
        raise ConfigError(f"there is no {truth}; name the folder with --data or TAGMILL_TESTDATA")
    cases, missing = [], []
    for name, entry in json.loads(truth.read_text()).items():
        if Path(name).suffix.lower() not in PICTURES:
            continue
        grey = cv2.imread(str(data / name), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            missing.append(name)
            continue
        markers = tuple(_true(one) for one in entry["markers"])
        searched = family(entry["dictionary"].split(" ")[0], data)
        cases.append(Case(name.split("/")[0], np.asarray(grey, dtype=np.uint8), searched, markers))
    return cases, missing


def marker_free(data: Path | None, seed: int, scenes: int) -> Iterator[Case]:
    """Rendered backgrounds and look-alikes, and crops of pictures that hold no marker of the searched family.

    ``data``: where photographs are; None: there are none.
    """
    searched = family(SEARCHED, Path())
    others = [family(name, Path()) for name in LOOK_ALIKES]
    for scene in marker_scenes.look_alikes(others, seed, scenes):
        yield _case(EMPTY, scene, searched)
    for scene in marker_scenes.empty(seed, scenes):
        yield _case(EMPTY, scene, searched)
    for picture in _without_markers(data) if data is not None else ():
        for crop in _crops(picture):
            yield Case(EMPTY, crop, searched, ())


def _without_markers(data: Path) -> Iterator[Grey]:
    """Pictures of boards, baskets and other families' markers, and some frames of a video of such."""
    names = {name for folder in CHESSBOARDS for name in sorted((data / folder).glob("*")) if name.suffix in PICTURES}
    if (data / "truth.json").is_file():
        truth = json.loads((data / "truth.json").read_text())
        names |= {
            data / name for name, entry in truth.items() if not entry.get("dictionary", "tag36").startswith("tag36")
        }
    for name in sorted(names):
        grey = cv2.imread(str(name), cv2.IMREAD_GRAYSCALE) if name.suffix.lower() in PICTURES else None
        if grey is not None and "depth" not in name.name:
            yield np.asarray(grey, dtype=np.uint8)
    video = cv2.VideoCapture(str(data / VIDEO))
    number = 0
    while video.grab():
        if number % VIDEO_STEP == 0:
            yield np.asarray(cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        number += 1


def _crops(grey: Grey) -> Iterator[Grey]:
    width, height = CROP
    for top in range(0, max(grey.shape[0] - height, 0) + 1, height):
        for left in range(0, max(grey.shape[1] - width, 0) + 1, width):
            yield np.ascontiguousarray(grey[top : top + height, left : left + width])


def _case(row: str, scene: marker_scenes.Scene, searched: Family) -> Case:
    markers = tuple(TrueMarker(one.id, one.corners, one.corners.mean(axis=0)) for one in scene.markers)
    return Case(row, scene.grey, searched, markers, rendered=True)


def _true(entry: dict[str, Any]) -> TrueMarker:
    corners = np.array(entry["corners"], dtype=np.float64) if "corners" in entry else None
    return TrueMarker(int(entry["id"]), corners, None if corners is None else corners.mean(axis=0))
