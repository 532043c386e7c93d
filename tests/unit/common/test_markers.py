from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import ConfigError
from common.markers import family, names

HERE = Path()


@pytest.mark.parametrize("name", sorted(n for n in dir(cv2.aruco) if n.startswith("DICT_")))
def test_every_predefined_dictionary_is_known_in_any_spelling(name: str) -> None:
    number = getattr(cv2.aruco, name)
    expected = cv2.aruco.getPredefinedDictionary(number)
    for spelling in (name, name.lower(), name.removeprefix("DICT_"), name.removeprefix("DICT_").upper()):
        found = family(spelling, HERE)
        assert found.ids == len(expected.bytesList)
        assert found.bits == expected.markerSize
        assert found.apriltag == ("APRILTAG" in name.upper())
        assert found.name in names()


def test_apriltags_own_name_is_understood() -> None:
    assert family("tag36h11", HERE).name == "apriltag_36h11"


def test_apriltag_bitmap_is_upright_as_apriltag_defines_it() -> None:
    # The code word of tag36h11's id 0 in the AprilTag library is 0xd5d628584, rows from the top, most
    # significant bit first: an anchor that no cv2 drawing is behind.
    code = [(0xD5D628584 >> (35 - i)) & 1 for i in range(36)]
    bitmap = family("apriltag_36h11", HERE).bitmap(0)
    assert bitmap[1:-1, 1:-1].tolist() == np.array(code).reshape(6, 6).tolist()


def test_aruco_bitmap_is_as_cv2_draws_it() -> None:
    found = family("6x6_250", HERE)
    drawn = cv2.aruco.generateImageMarker(found.dictionary, 23, 8) // 255
    assert found.bitmap(23).tolist() == drawn.tolist()
    assert found.own_order == (0, 1, 2, 3)


@pytest.mark.parametrize("name", ["apriltag_16h5", "4x4_50", "7x7_1000", "aruco_original"])
def test_bitmap_has_a_black_border_and_two_values(name: str) -> None:
    found = family(name, HERE)
    for marker in (0, found.ids - 1):
        bitmap = found.bitmap(marker)
        assert bitmap.shape == (found.cells, found.cells)
        assert bitmap.dtype == np.uint8
        assert set(np.unique(bitmap)) <= {0, 1}
        frame = bitmap.copy()
        frame[1:-1, 1:-1] = 0
        assert not frame.any()


def test_an_id_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="0 to 49, not 50"):
        family("4x4_50", HERE).bitmap(50)


@pytest.mark.parametrize(
    ("name", "hint"),
    [("apriltag36h11", "apriltag_36h11"), ("DICT_4x4_5", "4x4_50"), ("5x5-100", "5x5_100"), ("tag36h1", "tag36h11")],
)
def test_a_misspelt_name_brings_a_suggestion(name: str, hint: str) -> None:
    with pytest.raises(ConfigError, match=f"did you mean .*{hint}"):
        family(name, HERE)


@pytest.mark.parametrize("name", ["", "quite something else"])
def test_a_name_like_no_other_brings_the_list(name: str) -> None:
    with pytest.raises(ConfigError, match=r"known are .*4x4_50"):
        family(name, HERE)


def test_custom_dictionary_is_read_relative_to_the_folder(testdata: Callable[[str], Path]) -> None:
    path = testdata("opencv/tutorial_dict.yml")
    found = family("opencv/tutorial_dict.yml", path.parents[1])
    assert (found.ids, found.bits, found.apriltag) == (35, 6, False)
    assert found.bitmap(0)[1, 1:-1].tolist() == [1, 0, 1, 0, 1, 1]
    # The file doesn't say what may be corrected; its patterns do.
    assert found.dictionary.maxCorrectionBits == (found.distance - 1) // 2 > 0


HEAD = "%YAML:1.0\n---\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "no OpenCV FileStorage"),
        ("just text\n", "no OpenCV FileStorage"),
        (HEAD + "something: 1\n", "nmarkers"),
        (HEAD + 'nmarkers: 2\nmarkersize: 3\nmarker_0: "101011110"\n', "marker_"),
        (HEAD + 'nmarkers: 1\nmarkersize: 3\nmarker_0: "10101"\n', "marker_"),
        (HEAD + "nmarkers: 1\nmarkersize: 3\nmarker_0: 101\n", "marker_"),
        (HEAD + 'nmarkers: x\nmarkersize: "e"\n', "markersize"),
        (HEAD + "nmarkers: 1000\nmarkersize: 3\n", "marker_"),
        (HEAD + 'nmarkers: 2\nmarkersize: 3\nmarker_0: "100000000"\nmarker_1: "001000000"\n', "alike"),
    ],
)
def test_a_broken_file_is_refused_with_the_reason(tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "mine.yml").write_text(content)
    with pytest.raises(ConfigError, match=rf"mine\.yml .*{reason}"):
        family("mine.yml", tmp_path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yml does not exist"):
        family("dictionaries/mine.yml", tmp_path)


def test_a_folder_or_a_binary_is_no_dictionary(tmp_path: Path) -> None:
    (tmp_path / "folder.yml").mkdir()
    with pytest.raises(ConfigError, match="does not exist"):
        family("folder.yml", tmp_path)
    (tmp_path / "picture.yml").write_bytes(bytes(range(256)) * 8)
    with pytest.raises(ConfigError, match="no OpenCV FileStorage"):
        family("picture.yml", tmp_path)


def test_a_dictionary_of_one_marker_will_do(tmp_path: Path) -> None:
    (tmp_path / "one.yml").write_text(HEAD + 'nmarkers: 1\nmarkersize: 3\nmarker_0: "101011110"\n')
    assert family("one.yml", tmp_path).ids == 1


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (HEAD + "a: " + "[" * 100_000, "nested deeper"),
        (HEAD + "nmarkers: 2000000000\nmarkersize: 3\n", "at most 4096"),
        (HEAD + "nmarkers: 1\nmarkersize: 40000\n", "at most 16"),
        (HEAD + "x" * (2 << 20), "larger than 1 MiB"),
    ],
)
def test_a_hostile_file_costs_nothing(tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "mine.yml").write_text(content)
    with pytest.raises(ConfigError, match=rf"mine\.yml .*{reason}"):
        family("mine.yml", tmp_path)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_what_cv2_writes_is_read_as_cv2_reads_it(tmp_path: Path, suffix: str) -> None:
    written = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    storage = cv2.FileStorage(str(tmp_path / f"mine.{suffix}"), cv2.FILE_STORAGE_WRITE)
    written.writeDictionary(storage)
    storage.release()
    found = family(f"mine.{suffix}", tmp_path)
    assert np.array_equal(found.dictionary.bytesList, written.bytesList)
    assert (found.bits, found.dictionary.maxCorrectionBits) == (5, written.maxCorrectionBits)
