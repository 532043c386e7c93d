from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import ConfigError
from common.markers import Family, family
from services.detect.markers import MarkerDetector, open_detector
from services.detect.markers.opencv import OpenCvDetector
from tests.support.rendered_marker import drawing, looking_at, render

HERE = Path()
KINDS = {"auto": "edges", "opencv": "subpix"}


@pytest.fixture(params=KINDS)
def detector_name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def picture_of(name: str, marker: int, corners: np.ndarray, size: tuple[int, int] = (640, 480)) -> np.ndarray:
    """An upright marker on white, its own corners at these pixels; supersampled 8 times."""
    cells = np.pad(drawing(name, marker) * 190 + 40, 2, constant_values=230).astype(np.uint8)
    n, fine = len(cells) - 4, 8
    big = cv2.resize(cells, None, fx=16, fy=16, interpolation=cv2.INTER_NEAREST)
    # A pixel's index is its centre, an edge lies half a pixel beside it.
    source = np.array([[2, 2], [2 + n, 2], [2 + n, 2 + n], [2, 2 + n]], dtype=np.float64) * 16 - 0.5
    target = (corners + 0.5) * fine - 0.5
    warp = cv2.getPerspectiveTransform(source.astype(np.float32), target.astype(np.float32))
    wide = cv2.warpPerspective(big, warp, (size[0] * fine, size[1] * fine), borderValue=230, flags=cv2.INTER_NEAREST)
    return cv2.resize(wide, size, interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("thorough", [False, True], ids=["fast", "thorough"])
@pytest.mark.parametrize("name", ["DICT_APRILTAG_36h11", "DICT_APRILTAG_16h5", "DICT_6X6_250", "DICT_4X4_50"])
def test_corners_are_the_markers_own_in_order(detector_name: str, name: str, thorough: bool) -> None:
    corners = np.array([[300.3, 120.2], [420.7, 180.1], [360.2, 300.8], [240.4, 240.6]])
    for marker in (0, 7, 29):
        (found,) = open_detector(name, HERE, thorough=thorough, detector=detector_name).detect(
            picture_of(name, marker, corners)
        )
        assert found.id == marker
        assert found.kind == KINDS[detector_name]
        assert np.abs(np.array(found.corners) - corners).max() < 1.0


def mean_offset(detector: MarkerDetector, side: float) -> np.ndarray:
    """Found minus true (x, y) px, averaged over positions of all sub-pixel phases.

    The errors of single corners (0.1 px and more) cancel; a shifted convention would stay.
    """
    phases = (np.arange(4) + 0.5) / 4
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]])
    off = []
    for x in phases:
        for y in phases:
            corners = square + np.array([60 + x, 50 + y])
            (found,) = detector.detect(picture_of("DICT_APRILTAG_36h11", 3, corners, (280, 260)))
            off.append(np.mean(np.array(found.corners) - corners, axis=0))
    return np.mean(off, axis=0)


@pytest.mark.parametrize("thorough", [False, True], ids=["fast", "thorough"])
def test_half_a_pixel_is_not_lost(detector_name: str, thorough: bool) -> None:
    detector = open_detector("apriltag_36h11", HERE, thorough=thorough, detector=detector_name)
    assert np.abs(mean_offset(detector, 160)).max() < 0.01


def test_doubling_keeps_the_pixel_convention(monkeypatch: pytest.MonkeyPatch) -> None:
    # What only the doubled picture shows comes back to where it is in the single one.
    search = OpenCvDetector._search
    monkeypatch.setattr(
        OpenCvDetector, "_search", lambda self, grey, scale: search(self, grey, scale) if scale == 2 else []
    )
    assert np.abs(mean_offset(open_detector("apriltag_36h11", HERE, thorough=True, detector="opencv"), 96)).max() < 0.01


def test_rendered_views_are_found_with_the_right_order(detector_name: str) -> None:
    rng = np.random.default_rng(6)
    detector = open_detector("apriltag_36h11", HERE, detector=detector_name)
    for marker in range(0, 587, 90):
        seen = render(drawing("DICT_APRILTAG_36h11", marker), 50, looking_at(rng, 500), rng)
        (found,) = detector.detect(seen.grey)
        assert found.id == marker
        assert np.linalg.norm(np.array(found.corners) - seen.corners, axis=1).max() < 1.5


def test_one_marker_is_reported_once_and_two_of_equal_id_twice(detector_name: str) -> None:
    left = np.array([[100, 100], [180, 100], [180, 180], [100, 180]], dtype=float)
    for thorough in (False, True):
        detector = open_detector("apriltag_36h11", HERE, thorough=thorough, detector=detector_name)
        one = picture_of("DICT_APRILTAG_36h11", 11, left)
        assert [m.id for m in detector.detect(one)] == [11]
        two = np.minimum(one, picture_of("DICT_APRILTAG_36h11", 11, left + np.array([110, 15])))
        assert [m.id for m in detector.detect(two)] == [11, 11]


def test_the_picture_is_only_read(detector_name: str) -> None:
    grey = picture_of("DICT_6X6_250", 3, np.array([[100, 100], [180, 100], [180, 180], [100, 180]], dtype=float))
    grey.flags.writeable = False
    for thorough in (False, True):
        assert [
            m.id for m in open_detector("6x6_250", HERE, thorough=thorough, detector=detector_name).detect(grey)
        ] == [3]


def test_empty_noisy_and_tiny_pictures_have_no_markers(detector_name: str) -> None:
    rng = np.random.default_rng(7)
    pictures = [np.zeros((480, 640), np.uint8), rng.integers(0, 256, (480, 640), dtype=np.uint8)]
    pictures += [np.full((h, w), 128, np.uint8) for h, w in ((1, 1), (3, 500), (16, 16), (17, 40))]
    for thorough in (False, True):
        detector = open_detector("apriltag_36h11", HERE, thorough=thorough, detector=detector_name)
        assert all(detector.detect(picture) == [] for picture in pictures)


def test_a_colour_picture_is_refused(detector_name: str) -> None:
    with pytest.raises(ValueError, match="grey picture"):
        open_detector("apriltag_36h11", HERE, detector=detector_name).detect(np.zeros((48, 64, 3), np.uint8))


def test_both_shapes_of_cv2s_answer_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    quad = np.array([[10, 10], [50, 10], [50, 50], [10, 50]], dtype=np.float32)
    detector = OpenCvDetector(family("6x6_250", HERE))

    class Answer:
        def __init__(self, quads: object, ids: object) -> None:
            self.detectMarkers = lambda grey: (quads, ids, ())

    for quads, ids in (
        ((quad.reshape(1, 4, 2),), np.array([[5]], dtype=np.int32)),
        ([quad.reshape(4, 1, 2)], np.array([5], dtype=np.int32)),
    ):
        monkeypatch.setattr(detector, "_detector", Answer(quads, ids))
        (found,) = detector.detect(np.zeros((64, 64), np.uint8))
        assert (found.id, found.corners) == (5, ((10, 10), (50, 10), (50, 50), (10, 50)))
    monkeypatch.setattr(detector, "_detector", Answer((), None))
    assert detector.detect(np.zeros((64, 64), np.uint8)) == []


def test_the_registry_takes_a_family_or_a_name_and_refuses_the_unknown() -> None:
    chosen: Family = family("4x4_50", HERE)
    assert open_detector(chosen, HERE).family is chosen
    assert open_detector("4X4_50", HERE).family.name == "4x4_50"
    with pytest.raises(ConfigError, match="did you mean 4x4_50"):
        open_detector("4x4_51", HERE)
    with pytest.raises(ConfigError, match="known are auto, opencv"):
        open_detector("4x4_50", HERE, detector="magic")
