"""Recall and correctness on real photographs, whose truth others made (truth.json)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.markers import family
from services.detect.markers import open_detector

Find = Callable[[str], Path]

PHOTOS = {
    # file: how many of truth.json's markers the fast and the thorough search find at least (cv2 4.14)
    "opencv/singlemarkersoriginal.jpg": (6, 6),
    "opencv/gboriginal.png": (35, 35),
    "opencv/choriginal.jpg": (17, 17),
    "opencv/diamondmarkers.png": (12, 12),
    "ubiquity/tag_01_d7_14cm.png": (1, 1),
    "ubiquity/tag_245-246_d7_14cm.png": (2, 2),
    "ubiquity/403.jpg": (1, 1),
    "nasa_swarmathon/33369213973_9d9bb4cc96_c.jpg": (12, 12),
    "nasa_swarmathon/34085369442_304b6bafd9_c.jpg": (25, 25),
    "nasa_swarmathon/34139872896_defdb2f8d9_c.jpg": (10, 10),
    "duckietown/test_image.png": (5, 5),
    "duckietown/test_image_multiple_03.png": (6, 6),
    "duckietown/test_image_multiple_06.png": (6, 6),
    "duckietown/test_image_multiple_09.png": (5, 5),
    "swat_hallway/IMG_0612.jpg": (1, 1),
    "swat_hallway/IMG_0613.jpg": (1, 1),
    "swat_hallway/IMG_0614.jpg": (1, 1),
    "swat_hallway/IMG_0615.jpg": (1, 1),
    "swat_hallway/IMG_0617.jpg": (1, 1),
    "apriltags_jl/tagtest.jpg": (3, 3),
}
CORNER_TOLERANCE_PX = {"opencv": 2.5, "ubiquity": 1.5, "nasa_swarmathon": 3.5}
"""OpenCV's gold corners are whole pixels of contours; ubiquity's markers are on paper that isn't flat, and their
truth is cv2's sub-pixel search at each corner; the nasa tags are 11-40 px small and blurred."""


def look(testdata: Find, file: str, *, thorough: bool) -> tuple[list[Any], list[dict[str, Any]]]:
    """What is found in a photo, and what is there."""
    path = testdata(file)
    entry = json.loads(testdata("truth.json").read_text())[file]
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    root = testdata("truth.json").parent
    detector = open_detector(entry["dictionary"].split(" ")[0], root, thorough=thorough)
    return detector.detect(grey), entry["markers"]


def matched(found: list[Any], truth: list[dict[str, Any]]) -> list[tuple[Any, dict[str, Any]]]:
    """Pairs of what was found and what is there, each used once; by id, and by place where it is known."""
    left, pairs = list(found), []
    for true in truth:
        for one in left:
            near = "corners" not in true or (
                np.linalg.norm(np.mean(one.corners, axis=0) - np.mean(true["corners"], axis=0)) < 6
            )
            if one.id == true["id"] and near:
                left.remove(one)
                pairs.append((one, true))
                break
    return pairs


@pytest.mark.parametrize("thorough", [False, True], ids=["fast", "thorough"])
@pytest.mark.parametrize("file", PHOTOS)
def test_markers_of_a_photo(testdata: Find, file: str, thorough: bool) -> None:
    found, truth = look(testdata, file, thorough=thorough)
    pairs = matched(found, truth)
    assert len(pairs) >= PHOTOS[file][thorough]
    assert {one.id for one in found} <= {true["id"] for true in truth}
    if not file.startswith("nasa"):  # its truth is not exhaustive
        assert Counter(one.id for one in found) <= Counter(true["id"] for true in truth)
    tolerance = CORNER_TOLERANCE_PX.get(file.split("/")[0], 0.0)
    for one, true in pairs:
        if "corners" in true:
            off = np.linalg.norm(np.array(one.corners) - np.array(true["corners"]), axis=1)
            assert off.max() <= tolerance, (one.id, off)
            assert off.mean() <= 1.7, (one.id, off)


@pytest.mark.parametrize("thorough", [False, True], ids=["fast", "thorough"])
def test_equal_ids_close_together_are_all_reported(testdata: Find, thorough: bool) -> None:
    found, truth = look(testdata, "opencv/diamondmarkers.png", thorough=thorough)
    assert Counter(one.id for one in found) == Counter(true["id"] for true in truth)


@pytest.mark.parametrize("file", sorted(f for f in PHOTOS if f.startswith("swat_hallway")))
def test_upright_tags_have_their_own_top_left_up_left(testdata: Find, file: str) -> None:
    # These tags hang upright on a wall: the independent anchor for the turn of cv2's AprilTag frames.
    (one,), _ = look(testdata, file, thorough=False)
    corners = np.array(one.corners)
    middle = corners.mean(axis=0)
    signs = np.sign(corners - middle).astype(int).tolist()
    assert signs == [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def markerless(find: Find) -> list[Path]:
    chess = find("opencv/chess/left01.jpg").parent
    sony = find("boofcv/sony_chess/frame01.jpg").parent
    basket = find("boofcv/kinect_basket/basket_rgb.png")
    return [*sorted(chess.glob("left*.jpg"))[:4], *sorted(sony.glob("*.jpg"))[:3], basket]


@pytest.mark.parametrize("name", ["apriltag_36h11", "6x6_250", "5x5_1000", "aruco_mip_36h12"])
def test_no_marker_is_seen_where_there_is_none(testdata: Find, name: str) -> None:
    fast = open_detector(family(name, Path()), Path())
    thorough = open_detector(family(name, Path()), Path(), thorough=True)
    for path in markerless(testdata):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert fast.detect(grey) == [], path.name
        assert thorough.detect(grey) == [], path.name


def test_both_tags_are_found_all_through_a_video(testdata: Find) -> None:
    video = cv2.VideoCapture(str(testdata("wpical/two_tags.mp4")))
    detector = open_detector("apriltag_36h11", Path())
    seen, number = [], 0
    while True:
        more, frame = video.read()
        if not more:
            break
        if number % 20 == 0:
            seen.append(sorted(m.id for m in detector.detect(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))))
        number += 1
    assert number == 159
    assert seen == [[3, 4]] * 8
