"""What our own search must find and must not: one scene of each difficulty, every kind of family, look-alikes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from common.markers import family
from services.detect.markers import open_detector
from services.detect.markers.auto import AutoDetector
from services.detect.markers.code_book import CodeBook
from services.detect.markers.opencv import OpenCvDetector
from tests.support.rendered_marker import drawing, looking_at, render
from tools.bench import marker_scenes

HERE = Path()
LEAST = {"tilt 60": 6, "tilt 70": 3, "motion 16 px": 4, "6 equal ids": 6}


@pytest.mark.parametrize("row", marker_scenes.ROWS)
def test_a_scene_of_each_difficulty(row: str) -> None:
    searched = family("apriltag_36h11", HERE)
    scene = marker_scenes.ROWS[row](searched, np.random.default_rng([5, len(row)]))
    found = open_detector(searched, HERE).detect(scene.grey)
    true = sorted(marker.id for marker in scene.markers)
    assert len(found) >= LEAST.get(row, len(true))
    assert {marker.id for marker in found} <= set(true)


@pytest.mark.parametrize(
    "name", ["4X4_50", "4X4_1000", "5X5_1000", "7X7_250", "ARUCO_ORIGINAL", "APRILTAG_25h9", "APRILTAG_16h5"]
)
def test_families_of_few_and_many_bits(name: str) -> None:
    rng = np.random.default_rng(9)
    detector = open_detector(name.lower(), HERE)
    for marker in (0, 7, 29):
        seen = render(drawing(f"DICT_{name}", marker), 50, looking_at(rng, 600, 40), rng)
        (found,) = detector.detect(seen.grey)
        assert found.id == marker
        assert np.abs(np.array(found.corners) - seen.corners).max() < 0.4


@pytest.mark.parametrize("other", ["apriltag_36h10", "aruco_mip_36h12", "6x6_250", "apriltag_25h9"])
@pytest.mark.parametrize("thorough", [False, True], ids=["fast", "thorough"])
def test_markers_of_another_family_are_not_taken_for_ours(other: str, thorough: bool) -> None:
    detector = open_detector("apriltag_36h11", HERE, thorough=thorough)
    for scene in marker_scenes.look_alikes([family(other, HERE)], 4, 1):
        assert detector.detect(scene.grey) == []


def test_few_bits_are_left_to_cv2(tmp_path: Path) -> None:
    (tmp_path / "tiny.yml").write_text(
        '%YAML:1.0\n---\nnmarkers: 2\nmarkersize: 3\nmarker_0: "110100010"\nmarker_1: "111001000"\n'
    )
    detector = AutoDetector(family("tiny.yml", tmp_path))
    assert isinstance(detector._chosen, OpenCvDetector)
    assert detector.follow(np.zeros((64, 64), np.uint8), detector.detect(np.zeros((64, 64), np.uint8))) == []


def test_a_lens_full_of_random_levels_holds_no_marker() -> None:
    book = CodeBook(family("apriltag_36h11", HERE))
    noise = np.random.default_rng(3).normal(0, 1, (4000, 36)).astype(np.float32)
    assert not book.match(noise).sure.any()


@pytest.mark.parametrize("name", ["4x4_50", "apriltag_16h5", "5x5_250", "apriltag_36h11"])
def test_each_pattern_is_itself_in_each_turn(name: str) -> None:
    chosen = family(name, HERE)
    book = CodeBook(chosen)
    grids = [np.rot90(chosen.bitmap(m), t)[1:-1, 1:-1].ravel() for m in range(chosen.ids) for t in range(4)]
    match = book.match(np.array(grids, dtype=np.float32) * 90 + 20)
    assert match.sure.all()
    assert (match.ids * 4 + match.turns).tolist() == list(range(4 * chosen.ids))
