"""ROS 1 bags, ROS 2 bags and MCAP files as cameras."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import EndOfStreamError, FrameSkippedError, Grabbed
from services.capture.cameras.files import FilesCamera
from tests.unit.services.capture.bag_writing import KINDS, PERIOD_NS, START_NS, Bag, write_rgbd
from tests.unit.services.capture.conftest import write_calibration, write_depths

RigOf = Callable[[str], Rig]
TOPICS = "topic: /cam/color/image_raw, depth_topic: /cam/aligned_depth/image_raw"


def opened(rig_of: RigOf, path: Path, keys: str = "") -> FilesCamera:
    rig = rig_of(f"{{driver: files, pace: consumer, path: {path}{', ' if keys else ''}{keys}}}")
    return FilesCamera("cam0", rig.camera("cam0"), rig)


def rest_of(camera: FilesCamera) -> list[Grabbed]:
    frames = []
    while True:
        try:
            frames.append(camera.grab(1.0))
        except EndOfStreamError:
            return frames


@pytest.mark.parametrize("kind", KINDS)
def test_colour_depth_times_and_intrinsics_come_from_the_bag(rig_of: RigOf, tmp_path: Path, kind: str) -> None:
    camera = opened(rig_of, write_rgbd(kind, tmp_path / "recorded", 4), TOPICS)
    about = camera.describe()
    assert (about.camera.intrinsics_from, about.depth_unit_mm) == ("factory", 1.0)
    assert about.camera.matrix[0] == (70.0, 0.0, 31.5)
    assert about.camera.distortion[:2] == (0.1, -0.2)
    assert about.fps == pytest.approx(30, rel=0.15)
    for _ in range(2):
        frames = rest_of(camera)
        assert [frame.bgr[0, 0].tolist() for frame in frames] == [[0, 0, 10 * number] for number in range(1, 5)]
        assert [int(frame.depth.max()) for frame in frames if frame.depth is not None] == [1000, 2000, 3000, 4000]
        assert [frame.device_ns for frame in frames] == [START_NS + number * PERIOD_NS for number in range(4)]
        camera.rewind()
    camera.rewind(3)
    assert [frame.bgr[0, 0, 2] for frame in rest_of(camera)] == [40]
    camera.close()
    camera.close()


@pytest.mark.parametrize(("kind", "pattern"), [("mcap", "*.mcap"), ("sqlite3", "*.db3")])
def test_the_file_of_a_ros2_bag_plays_without_its_folder(
    rig_of: RigOf, tmp_path: Path, kind: str, pattern: str
) -> None:
    (file,) = write_rgbd(kind, tmp_path / "recorded", 2).glob(pattern)
    alone = file.rename(tmp_path / file.name)
    assert len(rest_of(opened(rig_of, alone))) == 2


def test_of_several_topics_one_must_be_chosen_and_they_are_listed(rig_of: RigOf, tmp_path: Path) -> None:
    path = write_rgbd("mcap", tmp_path / "recorded", 2, other=True)
    listed = r"/cam/color/image_raw \(Image, 2\), .*/wrist/image/compressed \(CompressedImage, 2\)"
    with pytest.raises(
        ConfigError,
        match=rf"cameras\.cam0\.topic: .* has 2 topics with colour pictures; name one as `topic`: .*{listed}",
    ):
        opened(rig_of, path)
    with pytest.raises(ConfigError, match=r"has no image topic /cam/image; name one as `topic`"):
        opened(rig_of, path, "topic: /cam/image")
    with pytest.raises(ConfigError, match=r"cameras\.cam0\.depth_topic: .* has no image topic /depth"):
        opened(rig_of, path, "topic: /cam/color/image_raw, depth_topic: /depth")
    with pytest.raises(ConfigError, match=r"info_topic: .* no camera_info /x; there is /cam/color/camera_info"):
        opened(rig_of, path, "topic: /cam/color/image_raw, info_topic: /x")
    wrist = opened(rig_of, path, "topic: /wrist/image/compressed")
    assert wrist.describe().camera.intrinsics_from == "guess"
    assert abs(int(wrist.grab(1.0).bgr[0, 0, 0]) - 10) <= 2, "the wrist's JPEG was written as BGR"
    chosen = "topic: /wrist/image/compressed, info_topic: /cam/color/camera_info"
    assert opened(rig_of, path, chosen).describe().camera.intrinsics_from == "factory"


def test_a_calibration_wins_over_camera_info(rig_of: RigOf, tmp_path: Path) -> None:
    path = write_rgbd("ros1", tmp_path / "recorded", 1)
    write_calibration(tmp_path / "cam.yaml", 64, 48)
    assert opened(rig_of, path, "calibration: cam.yaml").describe().camera.intrinsics_from == "calibration"


def pictures() -> dict[str, tuple[Callable[[Bag], Any], list[int]]]:
    """Messages of 48x64 pixels and the BGR of each."""
    flat = np.zeros((48, 64), np.uint8)
    rgb = np.dstack([flat + 200, flat + 100, flat + 50])
    bgr = [50, 100, 200]
    mosaic = np.zeros((48, 64), np.uint8)
    mosaic[::2, ::2], mosaic[::2, 1::2], mosaic[1::2, ::2], mosaic[1::2, 1::2] = 200, 100, 100, 50
    alpha = np.dstack([rgb, flat])
    return {
        "rgb8": (lambda bag: bag.image(rgb, "rgb8", 1), bgr),
        "bgr8": (lambda bag: bag.image(rgb[..., ::-1], "bgr8", 1, padding=5), bgr),
        "rgba8": (lambda bag: bag.image(alpha, "rgba8", 1), bgr),
        "bgra8": (lambda bag: bag.image(np.dstack([rgb[..., ::-1], flat]), "bgra8", 1), bgr),
        "mono8": (lambda bag: bag.image(flat + 70, "mono8", 1), [70] * 3),
        "mono16": (lambda bag: bag.image(np.full((48, 64), 70 * 257, "<u2"), "mono16", 1), [70] * 3),
        "bayer_rggb8": (lambda bag: bag.image(mosaic, "bayer_rggb8", 1), bgr),
        "bayer_bggr8": (lambda bag: bag.image(mosaic[::-1, ::-1], "bayer_bggr8", 1), bgr),
        "bayer_grbg8": (lambda bag: bag.image(mosaic[:, ::-1], "bayer_grbg8", 1), bgr),
        "bayer_gbrg8": (lambda bag: bag.image(mosaic[::-1], "bayer_gbrg8", 1), bgr),
        "png": (lambda bag: bag.compressed(rgb[..., ::-1], "bgr8; png compressed bgr8", 1), bgr),
    }


@pytest.mark.parametrize("encoding", pictures())
def test_every_encoding_becomes_bgr(rig_of: RigOf, tmp_path: Path, encoding: str) -> None:
    message, wanted = pictures()[encoding]
    with Bag("ros1", tmp_path / "recorded") as bag:
        bag.write("/cam/image", message(bag), 1)
    frame = opened(rig_of, bag.path).grab(1.0)
    assert np.abs(frame.bgr[20:28, 20:28].astype(int) - wanted).max() <= 1


def test_depth_in_metres_and_compressed_depth_become_steps(rig_of: RigOf, tmp_path: Path) -> None:
    metres = np.full((48, 64), 1.2345, np.float32)
    metres[0, :3] = np.nan, np.inf, -1
    steps = np.full((48, 64), 4321, np.uint16)
    with Bag("sqlite3", tmp_path / "recorded") as bag:
        bag.write("/cam/image", bag.image(np.zeros((48, 64), np.uint8), "mono8", 10**9), 10**9)
        bag.write("/float/depth", bag.image(metres, "32FC1", 10**9), 10**9)
        packed = bag.compressed(steps, "16UC1; compressedDepth png", 10**9, head=bytes(12))
        bag.write("/packed/depth", packed, 10**9)
    floats = opened(rig_of, bag.path, "depth_topic: /float/depth, depth_unit_mm: 0.5").grab(1.0).depth
    assert floats is not None
    assert (floats[10, 10], floats[0, :3].tolist()) == (2469, [0, 0, 0])
    assert (opened(rig_of, bag.path, "depth_topic: /packed/depth").grab(1.0).depth == steps).all()


def test_depth_of_another_size_or_time_is_not_taken(rig_of: RigOf, tmp_path: Path) -> None:
    with Bag("ros1", tmp_path / "recorded") as bag:
        for second in (1, 2):
            bag.write("/cam/image", bag.image(np.zeros((48, 64), np.uint8), "mono8", second * 10**9), second * 10**9)
        bag.write("/small/depth", bag.image(np.ones((24, 32), np.uint16), "16UC1", 10**9), 10**9)
        bag.write("/late/depth", bag.image(np.ones((48, 64), np.uint16), "16UC1", 2 * 10**9 + 30_000_000), 3 * 10**9)
    small = opened(rig_of, bag.path, "depth_topic: /small/depth")
    with pytest.raises(FrameSkippedError, match="32x24 pixels, /cam/image 64x48; depth must be aligned"):
        small.grab(1.0)
    assert small.grab(1.0).depth is None
    assert [frame.depth for frame in rest_of(opened(rig_of, bag.path, "depth_topic: /late/depth"))] == [None, None]


@pytest.mark.parametrize(
    ("model", "distortion", "topic", "focal", "kind"),
    [
        ("equidistant", (0.01, 0.02, 0.0, 0.0), "/cam/image", 70.0, "fisheye"),
        ("plumb_bob", (0.1, 0.0, 0.0, 0.0, 0.0), "/cam/image_rect", 60.0, "pinhole"),
        ("rational_polynomial", (0.1,) + (0.0,) * 7, "/cam/image", 70.0, "pinhole"),
        ("unheard_of", (0.1, 0.2), "/cam/image", None, "pinhole"),
    ],
)
def test_lens_models(
    rig_of: RigOf, tmp_path: Path, model: str, distortion: tuple[float, ...], topic: str, focal: float | None, kind: str
) -> None:
    with Bag("mcap", tmp_path / "recorded") as bag:
        bag.write("/cam/camera_info", bag.info(1, model, distortion), 1)
        bag.write(topic, bag.image(np.zeros((48, 64), np.uint8), "mono8", 1), 1)
    about = opened(rig_of, bag.path).describe().camera
    assert about.model == kind
    assert about.intrinsics_from == ("guess" if focal is None else "factory")
    assert focal is None or about.matrix[0][0] == focal


def test_damaged_messages_are_skipped_and_unknown_encodings_named(rig_of: RigOf, tmp_path: Path) -> None:
    grey = np.zeros((48, 64), np.uint8)
    with Bag("ros1", tmp_path / "recorded") as bag:
        whole, odd, short, shared = (bag.image(grey, name, 1) for name in ("mono8", "odd", "mono8", "yuyv"))
        short.data = short.data[:100]
        shared.width = 31  # in YUV 4:2:2 two pixels share a colour
        for number, message in enumerate((whole, odd, short, shared, whole)):
            bag.write("/cam/image", message, number)
    camera = opened(rig_of, bag.path)
    camera.grab(1.0)
    with pytest.raises(FrameSkippedError, match=r"#1 has the encoding odd; known are bgr8, "):
        camera.grab(1.0)
    with pytest.raises(FrameSkippedError, match="#2 is cut off: 100 bytes for 64x48 pixels"):
        camera.grab(1.0)
    with pytest.raises(FrameSkippedError, match="#3 can't be yuyv with 31x48 pixels"):
        camera.grab(1.0)
    camera.grab(1.0)


@pytest.mark.parametrize("name", ["broken.bag", "broken.mcap", "broken.db3"])
def test_a_file_that_is_no_bag_is_a_camera_error(rig_of: RigOf, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"no bag at all" * 40)
    with pytest.raises(CameraError, match=rf"{name} can't be read as a bag"):
        opened(rig_of, tmp_path / name)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_that_was_cut_off_is_a_camera_error_or_plays_what_is_there(
    rig_of: RigOf, tmp_path: Path, kind: str
) -> None:
    path = write_rgbd(kind, tmp_path / "recorded", 6)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in {".mcap", ".db3"})
    data = file.read_bytes()
    for share in (0.1, 0.5, 0.9):
        file.write_bytes(data[: int(len(data) * share)])
        with contextlib.suppress(CameraError, FrameSkippedError):  # anything else is a bug
            assert len(rest_of(opened(rig_of, path, TOPICS))) <= 6


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes_are_told_and_never_a_bug(rig_of: RigOf, tmp_path: Path, kind: str) -> None:
    path = write_rgbd(kind, tmp_path / "recorded", 2)
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in {".mcap", ".db3"})
    data, random = file.read_bytes(), np.random.default_rng(7)
    for _ in range(8):
        damaged = bytearray(data)
        for at in random.integers(len(data), size=20):
            damaged[at] = random.integers(256)
        file.write_bytes(damaged)
        with contextlib.suppress(CameraError, FrameSkippedError, ConfigError):
            rest_of(opened(rig_of, path, TOPICS))


def test_without_rosbags_it_says_what_to_install(
    rig_of: RigOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_rgbd("ros1", tmp_path / "recorded", 1)
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "services.capture.cameras.file_opening.find_spec", lambda name: None if name == "rosbags" else found(name)
    )
    with pytest.raises(ConfigError, match=r"is a bag, which needs the package rosbags; pip install 'tagmill\[bags\]'"):
        opened(rig_of, path)


def test_a_depth_folder_beside_a_bag_is_refused(rig_of: RigOf, tmp_path: Path) -> None:
    path = write_rgbd("ros1", tmp_path / "recorded", 1)
    write_depths(tmp_path / "far", 1)
    with pytest.raises(ConfigError, match=r"depth_path: a bag takes no depth pictures .* `depth_topic`"):
        opened(rig_of, path, "depth_path: far")


def test_a_real_bag(rig_of: RigOf, testdata: Callable[[str], Path]) -> None:
    camera = opened(rig_of, testdata("ubiquity/aruco_images.bag"))
    assert camera.describe().camera.matrix[0][0] == pytest.approx(1014.34310)
    (frame,) = rest_of(camera)
    assert frame.bgr.shape == (960, 1280, 3)
    assert frame.device_ns == 1491682360314066469
