"""The ``files`` driver with generated pictures and videos, and with a real video."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config import Rig
from common.errors import CameraError, ConfigError
from services.capture.cameras.base import EndOfStreamError, FrameSkippedError, Grabbed
from services.capture.cameras.files import FilesCamera
from tests.unit.services.capture.conftest import (
    HEIGHT,
    WIDTH,
    grey_picture,
    write_calibration,
    write_depths,
    write_pictures,
    write_video,
)

RigOf = Callable[[str], Rig]
FAST = "pace: consumer"


def opened(rig: Rig) -> FilesCamera:
    return FilesCamera("cam0", rig.camera("cam0"), rig)


def rest_of(camera: FilesCamera) -> list[Grabbed]:
    frames = []
    while True:
        try:
            frames.append(camera.grab(1.0))
        except EndOfStreamError:
            return frames


def values(frames: list[Grabbed]) -> list[int]:
    return [int(frame.bgr.mean().round()) for frame in frames]


def test_a_folder_is_played_in_natural_order_under_the_files_names(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 11)
    camera = opened(rig_of(f"{{driver: files, path: photos, {FAST}}}"))
    frames = rest_of(camera)
    assert values(frames) == [10 * number for number in range(1, 12)]
    assert [frame.source_name for frame in frames] == [f"img{number}.png" for number in range(1, 12)]
    assert all(frame.device_ns is None and frame.depth is None for frame in frames)


def test_a_video_is_played_with_its_times_and_indices(rig_of: RigOf, tmp_path: Path) -> None:
    write_video(tmp_path / "clip.avi", 8, fps=20)
    camera = opened(rig_of(f"{{driver: files, path: clip.avi, {FAST}}}"))
    assert camera.describe().fps == pytest.approx(20)
    frames = rest_of(camera)
    assert np.allclose(values(frames), [10 * number for number in range(1, 9)], atol=3)
    assert [frame.source_name for frame in frames] == [f"clip.avi#{index}" for index in range(8)]
    times = [frame.device_ns or 0 for frame in frames]
    assert np.allclose(np.diff(times), 50e6, rtol=0.01)


def test_the_real_video_has_all_its_frames(rig_of: RigOf, testdata: Callable[[str], Path]) -> None:
    camera = opened(rig_of(f"{{driver: files, path: {testdata('wpical/two_tags.mp4')}, {FAST}}}"))
    assert (camera.describe().camera.width, camera.describe().camera.height) == (1920, 1080)
    stamps, count = set(), 0
    while True:
        try:
            frame = camera.grab(1.0)
        except EndOfStreamError:
            break
        assert frame.bgr.shape == (1080, 1920, 3)
        stamps.add(frame.device_ns)
        count += 1
    assert count == len(stamps) == 159


def test_the_photo_folders_are_played_to_the_last(rig_of: RigOf, testdata: Callable[[str], Path]) -> None:
    for folder, count in (("duckietown", 4), ("ubiquity", 3), ("opencv/chess", 13), ("swat_hallway", 5)):
        assert len(rest_of(opened(rig_of(f"{{driver: files, path: {testdata(folder)}, {FAST}}}")))) == count


def test_a_file_waits_for_its_start_unless_told_otherwise(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    for keys, waits in (("", True), (", begin: at_start", False), (", loop: true", False)):
        assert opened(rig_of(f"{{driver: files, path: photos{keys}}}")).describe().waits_for_start is waits


@pytest.mark.parametrize("source", ["photos", "clip.avi"])
def test_rewinding_goes_to_any_frame(rig_of: RigOf, tmp_path: Path, source: str) -> None:
    write_pictures(tmp_path / "photos", 5)
    write_video(tmp_path / "clip.avi", 5)
    camera = opened(rig_of(f"{{driver: files, path: {source}, {FAST}}}"))
    names = [frame.source_name for frame in rest_of(camera)]
    for start in (0, 3, 4, 5):
        camera.rewind(start)
        assert [frame.source_name for frame in rest_of(camera)] == names[start:]


def test_what_was_added_to_the_folder_is_in_the_next_pass(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 2)
    camera = opened(rig_of(f"{{driver: files, path: photos, {FAST}}}"))
    assert len(rest_of(camera)) == 2
    write_pictures(tmp_path / "photos", 4)
    camera.rewind()
    assert len(rest_of(camera)) == 4


@pytest.mark.parametrize("source", ["photos", "clip.avi", "one.avi"])
def test_a_loop_begins_again_and_its_clock_goes_on(rig_of: RigOf, tmp_path: Path, source: str) -> None:
    write_pictures(tmp_path / "photos", 3)
    write_video(tmp_path / "clip.avi", 3)
    write_video(tmp_path / "one.avi", 1)
    length = 1 if source == "one.avi" else 3
    camera = opened(rig_of(f"{{driver: files, path: {source}, loop: true, {FAST}}}"))
    frames = [camera.grab(1.0) for _ in range(3 * length)]
    assert [frame.source_name for frame in frames] == [frame.source_name for frame in frames[:length]] * 3
    if source != "photos":
        times = [frame.device_ns or 0 for frame in frames]
        assert times == sorted(set(times)), "a clock that stands still is a frozen camera"


def test_a_loop_of_unreadable_pictures_ends(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 2)
    camera = opened(rig_of(f"{{driver: files, path: photos, loop: true, {FAST}}}"))
    for path in (tmp_path / "photos").iterdir():
        path.write_bytes(b"")
    for _ in range(2):
        with pytest.raises(FrameSkippedError):
            camera.grab(1.0)
    with pytest.raises(EndOfStreamError):
        camera.grab(1.0)


def test_depth_pictures_come_with_theirs(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 3)
    write_depths(tmp_path / "far", 3)
    (tmp_path / "far" / "img2.png").unlink()
    camera = opened(rig_of(f"{{driver: files, path: photos, depth_path: far, depth_unit_mm: 0.5, {FAST}}}"))
    assert camera.describe().depth_unit_mm == 0.5
    depths = [frame.depth for frame in rest_of(camera)]
    assert [None if depth is None else int(depth.max()) for depth in depths] == [1000, None, 3000]
    assert all(depth is None or (depth.dtype == np.uint16 and depth.shape == (HEIGHT, WIDTH)) for depth in depths)


def test_a_video_takes_depth_pictures_by_order(rig_of: RigOf, tmp_path: Path) -> None:
    write_video(tmp_path / "clip.avi", 3)
    write_depths(tmp_path / "far", 3)
    frames = rest_of(opened(rig_of(f"{{driver: files, path: clip.avi, depth_path: far, {FAST}}}")))
    assert [int(frame.depth.max()) for frame in frames if frame.depth is not None] == [1000, 2000, 3000]


def test_depth_of_another_size_costs_its_frame(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 2)
    write_depths(tmp_path / "far", 2)
    write_depths(tmp_path / "far", 1, width=32)
    camera = opened(rig_of(f"{{driver: files, path: photos, depth_path: far, {FAST}}}"))
    with pytest.raises(FrameSkippedError, match="32x48 pixels, its picture 64x48") as caught:
        camera.grab(1.0)
    assert caught.value.reason == "depth_size"
    assert camera.grab(1.0).source_name == "img2.png"


def test_without_a_calibration_the_intrinsics_are_a_guess_and_say_so(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    description = opened(rig_of("{driver: files, path: photos}")).describe()
    assert description.camera.intrinsics_from == "guess"
    assert (description.camera.width, description.camera.height) == (WIDTH, HEIGHT)
    assert "no calibration" in description.warnings[0]


def test_a_calibration_holds_for_its_size_and_is_scaled_for_others(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    for scale in (1, 2):
        write_calibration(tmp_path / "cam.yaml", scale * WIDTH, scale * HEIGHT)
        description = opened(rig_of("{driver: files, path: photos, calibration: cam.yaml}")).describe()
        assert description.camera.intrinsics_from == "calibration"
        assert description.camera.matrix[0][0] == pytest.approx(1.1 * WIDTH)
        assert (description.camera.width, description.camera.height) == (WIDTH, HEIGHT)
        assert len(description.warnings) == scale - 1


def test_a_calibration_for_another_picture_is_an_error_that_names_both_sizes(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    write_calibration(tmp_path / "cam.yaml", 64, 64)
    with pytest.raises(CameraError, match=r"for 64x64, its pictures are 64x48"):
        opened(rig_of("{driver: files, path: photos, calibration: cam.yaml}"))


def test_pictures_of_differing_size_describe_themselves(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 2)
    cv2.imwrite(str(tmp_path / "photos" / "img3.png"), grey_picture(30, 100, 80))
    cv2.imwrite(str(tmp_path / "photos" / "img4.png"), grey_picture(40))
    camera = opened(rig_of(f"{{driver: files, path: photos, {FAST}}}"))
    sizes = []
    for _ in range(4):
        frame = camera.grab(1.0)
        described = camera.describe().camera
        assert frame.bgr.shape == (described.height, described.width, 3)
        sizes.append((described.width, described.height))
    assert sizes == [(64, 48), (64, 48), (100, 80), (64, 48)]


def test_one_that_does_not_fit_the_calibration_costs_only_itself(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 3)
    write_calibration(tmp_path / "cam.yaml", WIDTH, HEIGHT)
    cv2.imwrite(str(tmp_path / "photos" / "img2.png"), grey_picture(20, 48, 64))
    camera = opened(rig_of(f"{{driver: files, path: photos, calibration: cam.yaml, {FAST}}}"))
    assert camera.grab(1.0).source_name == "img1.png"
    with pytest.raises(FrameSkippedError, match=r"img2\.png.*64x48, its pictures are 48x64") as caught:
        camera.grab(1.0)
    assert caught.value.reason == "wrong_size"
    assert camera.grab(1.0).source_name == "img3.png"


def test_an_unreadable_picture_costs_only_itself(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 3)
    (tmp_path / "photos" / "img1.png").write_bytes(b"broken")
    camera = opened(rig_of(f"{{driver: files, path: photos, {FAST}}}"))
    with pytest.raises(FrameSkippedError, match=r"img1\.png"):
        camera.grab(1.0)
    assert values(rest_of(camera)) == [20, 30]


def test_only_unreadable_pictures_are_no_camera(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    (tmp_path / "photos" / "img1.png").write_bytes(b"broken")
    with pytest.raises(CameraError, match=r"img1\.png can't be read"):
        opened(rig_of("{driver: files, path: photos}"))


def test_a_size_in_the_rig_must_be_that_of_the_files(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 1)
    assert opened(rig_of("{driver: files, path: photos, width: 64, height: 48}"))
    with pytest.raises(CameraError, match="64x48 pixels, camera cam0 is configured for 1280x48"):
        opened(rig_of("{driver: files, path: photos, width: 1280}"))


@pytest.mark.parametrize("path", ["nowhere", "broken.mp4", "empty"])
def test_what_can_not_be_opened_is_a_camera_error(rig_of: RigOf, tmp_path: Path, path: str) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    (tmp_path / "empty").mkdir()
    with pytest.raises(CameraError, match=path):
        opened(rig_of(f"{{driver: files, path: {path}}}"))


def test_wrong_keys_are_a_config_error_that_names_them(rig_of: RigOf, tmp_path: Path) -> None:
    rig = rig_of("{driver: files, path: photos}")
    config = rig.camera("cam0").model_copy(update={"pace": "slow"})
    with pytest.raises(ConfigError, match=r"cameras\.cam0\.pace"):
        FilesCamera("cam0", config, rig)


def test_frames_come_at_their_rate_and_a_late_asker_gets_no_burst(rig_of: RigOf, tmp_path: Path) -> None:
    write_pictures(tmp_path / "photos", 6)
    camera = opened(rig_of("{driver: files, path: photos, fps: 20}"))
    began = time.monotonic()
    for _ in range(4):
        camera.grab(1.0)
    assert time.monotonic() - began >= 3 / 20 - 0.001, "never faster than its rate"
    with pytest.raises(TimeoutError):
        camera.grab(0.001)
    camera.rewind()
    assert camera.grab(0.0).source_name == "img1.png", "the first frame is due at once"
