"""Reading picture files, checked against what was written and against cv2's own reader."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import CameraError
from services.capture.cameras.base import FrameSkippedError
from services.capture.cameras.pictures import (
    exif_orientation,
    list_pictures,
    match_depth,
    natural_key,
    read_depth,
    read_picture,
)
from tests.unit.services.capture.conftest import grey_picture, write_pictures

QUARTERS = np.zeros((40, 60, 3), np.uint8)
QUARTERS[:20, :30], QUARTERS[20:, :30], QUARTERS[:20, 30:] = (0, 0, 255), (0, 255, 0), (255, 0, 0)


def exif(orientation: int, order: str = "<") -> bytes:
    head = b"II*\0" if order == "<" else b"MM\0*"
    entry = struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)
    return head + struct.pack(order + "IH", 8, 1) + entry + struct.pack(order + "I", 0)


def write_with_exif(path: Path, picture: np.ndarray, data: bytes) -> None:
    block = np.frombuffer(data, np.uint8)
    assert cv2.imwriteWithMetadata(str(path), picture, [cv2.IMAGE_METADATA_EXIF], [block])


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_every_exif_orientation_as_cv2_turns_it(tmp_path: Path, suffix: str, order: str, orientation: int) -> None:
    path = tmp_path / f"turned{suffix}"
    write_with_exif(path, QUARTERS, exif(orientation, order))
    ours, theirs = read_picture(path), cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert theirs is not None
    assert np.array_equal(ours, theirs)
    assert ours.shape == ((40, 60, 3) if orientation < 5 else (60, 40, 3))
    assert ours.flags.c_contiguous


def test_a_transparent_picture_is_turned_too(tmp_path: Path) -> None:
    path = tmp_path / "turned.png"
    write_with_exif(path, np.dstack([QUARTERS, np.full((40, 60), 255, np.uint8)]), exif(6))
    assert np.array_equal(read_picture(path), cv2.rotate(QUARTERS, cv2.ROTATE_90_CLOCKWISE))


@pytest.mark.parametrize("data", [b"", b"II*", b"junk" * 9, exif(0), exif(9), exif(6)[:14], b"II*\0\xff\xff\xff\xff"])
def test_exif_that_makes_no_sense_means_upright(data: bytes) -> None:
    assert exif_orientation(data) == 1


def test_16_bits_are_scaled_by_their_full_range(tmp_path: Path) -> None:
    values = np.array([[0, 128, 129, 257, 32768, 65535]], np.uint16)
    cv2.imwrite(str(tmp_path / "grey.png"), values)
    cv2.imwrite(str(tmp_path / "colour.png"), np.dstack([values, values, 65535 - values]))
    assert read_picture(tmp_path / "grey.png")[0, :, 1].tolist() == [0, 0, 1, 1, 128, 255]
    assert read_picture(tmp_path / "colour.png")[0, :, 2].tolist() == [255, 255, 254, 254, 127, 0]


def test_grey_becomes_bgr(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), QUARTERS[:, :, 2])
    read = read_picture(tmp_path / "grey.png")
    assert read.shape == (40, 60, 3)
    assert all(np.array_equal(read[:, :, channel], QUARTERS[:, :, 2]) for channel in range(3))


def test_transparency_is_shown_on_white(tmp_path: Path) -> None:
    picture = np.zeros((1, 3, 4), np.uint8)
    picture[0, :, :3] = (0, 100, 200)
    picture[0, :, 3] = (255, 0, 51)
    cv2.imwrite(str(tmp_path / "clear.png"), picture)
    assert read_picture(tmp_path / "clear.png")[0].tolist() == [[0, 100, 200], [255, 255, 255], [204, 224, 244]]


@pytest.mark.parametrize("suffix", [".bmp", ".tiff", ".ppm", ".png", ".webp"])
def test_colours_stay_in_bgr_order(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"colours{suffix}"
    assert cv2.imwrite(str(path), QUARTERS, [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else [])
    assert np.array_equal(read_picture(path), QUARTERS)


def test_real_photographs_are_read_as_cv2_reads_them(testdata) -> None:  # type: ignore[no-untyped-def]
    for relative in (
        "swat_hallway/IMG_0612.jpg",
        "apriltags_jl/tagtest.jpg",
        "nasa_swarmathon",
        "opencv/gboriginal.png",
    ):
        path = testdata(relative)
        for photo in [path] if path.is_file() else list_pictures(path):
            theirs = cv2.imread(str(photo), cv2.IMREAD_COLOR)
            ours = read_picture(photo).astype(int)
            assert theirs is not None
            # Grey JPEGs alone: cv2 lets libjpeg make BGR of them, which may round by one.
            assert np.abs(ours - theirs).max() <= 1


@pytest.mark.parametrize("content", [b"", b"no picture at all", b"\x89PNG\r\n\x1a\n" + b"\0" * 50])
def test_what_is_no_picture_is_skipped_with_its_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.png"
    path.write_bytes(content)
    for read in (read_picture, read_depth):
        with pytest.raises(FrameSkippedError, match=r"broken\.png") as caught:
            read(path)
        assert caught.value.reason == "unreadable"


def test_a_picture_of_floats_is_skipped_with_the_reason(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "float.tiff"), np.zeros((4, 4), np.float32))
    with pytest.raises(FrameSkippedError, match="pixels are float32"):
        read_picture(tmp_path / "float.tiff")


def test_a_folder_that_went_is_a_lost_camera_a_file_that_went_a_skipped_frame(tmp_path: Path) -> None:
    with pytest.raises(FrameSkippedError):
        read_picture(tmp_path / "gone.png")
    with pytest.raises(CameraError, match="is gone"):
        read_picture(tmp_path / "nowhere" / "gone.png")


def test_depth_is_kept_to_the_bit(tmp_path: Path) -> None:
    depth = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    assert np.array_equal(read_depth(tmp_path / "depth.png"), depth)


def test_depth_of_8_bits_or_in_colour_is_none(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), QUARTERS[:, :, 0])
    cv2.imwrite(str(tmp_path / "colour.png"), QUARTERS.astype(np.uint16))
    for name, told in (("grey", r"1 channel\(s\) of uint8"), ("colour", r"3 channel\(s\) of uint16")):
        with pytest.raises(FrameSkippedError, match=told):
            read_depth(tmp_path / f"{name}.png")


def test_natural_order() -> None:
    names = ["img10.png", "img2.png", "IMG1.png", "img2b.png", "9.png", "a/1.png", "10.png"]
    ordered = sorted((Path(name) for name in names), key=natural_key)
    assert [str(path) for path in ordered] == [
        "9.png",
        "10.png",
        "a/1.png",
        "IMG1.png",
        "img2.png",
        "img2b.png",
        "img10.png",
    ]


def test_what_a_path_names(tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 11)
    (tmp_path / "photos" / "notes.txt").write_text("no picture")
    (tmp_path / "photos" / ".hidden.png").write_bytes(b"")
    write_pictures(tmp_path / "photos" / "below", 1)
    assert [path.stem for path in list_pictures(tmp_path / "photos")] == [f"img{n}" for n in range(1, 12)]
    assert [path.stem for path in list_pictures(tmp_path / "photos" / "img1*.png")] == ["img1", "img10", "img11"]
    assert len(list_pictures(tmp_path / "photos" / "**" / "*.png")) >= 12
    assert len(list_pictures(tmp_path / "*" / "img2.png")) == 1
    assert [path.stem for path in list_pictures(tmp_path / "photos" / "img3.png")] == ["img3"]
    (tmp_path / "[odd] folder").mkdir()
    cv2.imwrite(str(tmp_path / "[odd] folder" / "x.png"), grey_picture(1))
    assert len(list_pictures(tmp_path / "[odd] folder")) == 1


@pytest.mark.parametrize("path", ["nowhere", "nowhere/*.png", "*.jpg", "empty", "notes.txt"])
def test_no_picture_is_told_with_the_path(tmp_path: Path, path: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(CameraError) as caught:
        list_pictures(tmp_path / path)
    assert str(tmp_path / path) in caught.value.message


def test_depth_is_matched_by_stem_or_by_order() -> None:
    def paths(*names: str) -> list[Path]:
        return [Path(name) for name in names]

    by_stem = match_depth(paths("c/a.png", "c/b.png"), paths("d/b.png", "d/a.png"))
    assert by_stem == [Path("d/a.png"), Path("d/b.png")]
    assert match_depth(paths("rgb_7.png", "rgb_8.png"), paths("depth_8.png")) == [None, Path("depth_8.png")]
    assert match_depth(paths("a1.png", "a2.png"), paths("z1.png", "z2.png")) == paths("z1.png", "z2.png")
    with pytest.raises(CameraError, match="3 depth pictures for 2 pictures"):
        match_depth(paths("a1.png", "a2.png"), paths("z1.png", "z2.png", "z3.png"))
