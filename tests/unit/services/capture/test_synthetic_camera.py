"""The synthetic driver's keys, beyond the contract that all drivers share. Tiny pictures keep it quick."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.config import load_rig
from common.errors import CameraError, ConfigError
from common.geometry import CameraModel, Pose
from common.scene import read_number
from services.capture.cameras.base import Camera, EndOfStreamError, Grabbed
from services.capture.cameras.registry import open_camera

ROOT = Path(__file__).parents[4]
OBJECTS = """\
objects:
  - name: box-1
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 100, border_mm: 15}
      left: {marker: 1, marker_size_mm: 100, border_mm: 15}
"""
CALIBRATION = """\
width: 160
height: 90
camera_matrix: [[120, 0, 79], [0, 121, 44], [0, 0, 1]]
distortion: [0.05, -0.1, 0, 0, 0]
"""
Open = Callable[[str], Camera]


@pytest.fixture
def opened(tmp_path: Path) -> Open:
    """``opened(keys)``: a synthetic camera of 160x90 with further keys."""

    def open_with(keys: str) -> Camera:
        path = tmp_path / "rig.yaml"
        path.write_text(f"{OBJECTS}cameras:\n  cam0: {{driver: synthetic, width: 160, height: 90, {keys}}}\n")
        rig = load_rig(path)
        return open_camera("cam0", rig.camera("cam0"), rig)

    return open_with


def take(camera: Camera, count: int) -> list[Grabbed]:
    return [camera.grab(5.0) for _ in range(count)]


def centre(frame: Grabbed) -> np.ndarray:
    assert frame.truth is not None
    return np.array(frame.truth[0].tvec_mm)


def rotation(frame: Grabbed) -> np.ndarray:
    assert frame.truth is not None
    return Pose.from_rvec(frame.truth[0].rvec, frame.truth[0].tvec_mm).rotation


def test_truth_fits_what_the_camera_says_of_itself(opened: Open) -> None:
    camera = opened("frames: 3, fps: 200")
    label = camera.describe().camera
    matrix, distortion = np.array(label.matrix), np.array(label.distortion)
    half = np.array([400.0, 300.0, 300.0]) / 2  # width X, depth Y, height Z
    signs = [(x, y, z) for y in (-1, 1) for x, z in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
    for frame in take(camera, 3):
        assert frame.truth is not None
        (true,) = frame.truth
        pixels, _ = cv2.projectPoints(half * signs, np.array(true.rvec), np.array(true.tvec_mm), matrix, distortion)
        assert np.abs(pixels[:, 0] - np.array(true.corners)).max() < 1e-6
        assert {marker.id for marker in true.markers} == {0, 1}


def test_the_object_moves_every_frame_at_any_rate(opened: Open) -> None:
    camera = opened("frames: 6, fps: 240")
    frames = take(camera, 6)
    steps = [np.linalg.norm(centre(b) - centre(a)) for a, b in pairwise(frames)]
    assert min(steps) > 0
    assert not any(np.array_equal(a.bgr, b.bgr) for a, b in pairwise(frames))


def test_time_runs_alike_at_any_rate(opened: Open) -> None:
    """A tenth of a second later the object is at the same place, and the lamp too, whatever the frame rate."""
    slow, fast = opened("fps: 10, noise: 0, blur_px: 0"), opened("fps: 60, noise: 0, blur_px: 0")
    late, same = take(slow, 2)[-1], take(fast, 7)[-1]
    np.testing.assert_allclose(centre(late), centre(same), atol=1e-6)
    assert np.array_equal(late.bgr, same.bgr)
    assert late.device_ns == same.device_ns == 100_000_000


def test_it_ends_after_its_frames(opened: Open) -> None:
    camera = opened("frames: 2, fps: 200")
    take(camera, 2)
    for _ in range(2):
        with pytest.raises(EndOfStreamError, match="2 frames"):
            camera.grab(1.0)


def test_frames_rendered_ahead_go_there_and_back(opened: Open) -> None:
    ahead, live = opened("prerendered: 4, fps: 200"), opened("frames: 4, fps: 200")
    path = take(live, 4)
    frames = take(ahead, 10)
    for number, frame in zip((0, 1, 2, 3, 2, 1, 0, 1, 2, 3), frames, strict=True):
        assert np.array_equal(frame.bgr, path[number].bgr)
        assert np.array_equal(frame.depth, path[number].depth)
        assert frame.truth == path[number].truth
    stamps = [frame.device_ns for frame in frames]
    assert stamps == sorted(set(stamps))


def test_a_picture_too_narrow_for_the_number_has_none(opened: Open) -> None:
    assert [read_number(frame.bgr) for frame in take(opened("burn_frame: true, fps: 200"), 2)] == [None, None]


def test_the_burnt_number_is_the_frames_own(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    keys = "driver: synthetic, width: 320, height: 180, prerendered: 2, burn_frame: true, fps: 200"
    path.write_text(f"{OBJECTS}cameras:\n  cam0: {{{keys}}}\n")
    rig = load_rig(path)
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    assert [read_number(frame.bgr) for frame in take(camera, 5)] == [0, 1, 2, 3, 4]


def test_while_its_cable_is_out_it_gives_nothing(opened: Open, tmp_path: Path) -> None:
    camera = opened("cable: out, fps: 200")
    take(camera, 1)
    cable = tmp_path / "out"
    cable.touch()
    with pytest.raises(CameraError, match=f"remove the file {cable}"):
        camera.grab(1.0)
    with pytest.raises(CameraError, match="unplugged"):
        opened("cable: out")
    cable.unlink()
    take(camera, 1)


def test_a_second_view_sees_the_same_scene_from_the_side(opened: Open) -> None:
    first, second = (take(opened(f"view: {view}, fps: 200"), 2) for view in (0, 30))
    for one, two in zip(first, second, strict=True):
        turn = rotation(two) @ rotation(one).T
        about = np.degrees(np.arccos((np.trace(turn) - 1) / 2))
        assert about == pytest.approx(30.0, abs=1e-6)
        np.testing.assert_allclose(turn @ [0, 1, 0], [0, 1, 0], atol=1e-9)  # round the vertical axis
    # One rigid motion leads from one camera to the other, in every frame.
    turn = rotation(second[0]) @ rotation(first[0]).T
    shifts = [centre(two) - turn @ centre(one) for one, two in zip(first, second, strict=True)]
    np.testing.assert_allclose(shifts[0], shifts[1], atol=1e-6)


def test_seeds_are_scenes(opened: Open) -> None:
    one, again, other = (take(opened(f"seed: {seed}, fps: 200"), 1)[0] for seed in (5, 5, 6))
    assert np.array_equal(one.bgr, again.bgr)
    assert np.array_equal(one.depth, again.depth)
    assert one.truth == again.truth != other.truth
    assert not np.array_equal(one.bgr, other.bgr)


def test_another_process_renders_the_same(opened: Open, tmp_path: Path) -> None:
    here = take(opened("seed: 9, fps: 200"), 1)[0]
    code = (
        "import sys, hashlib; from pathlib import Path; from common.config import load_rig;"
        "from services.capture.cameras.registry import open_camera;"
        "rig = load_rig(Path(sys.argv[1])); frame = open_camera('cam0', rig.camera('cam0'), rig).grab(5.0);"
        "print(hashlib.sha256(frame.bgr.tobytes() + frame.depth.tobytes()).hexdigest())"
    )
    child = [sys.executable, "-c", code, str(tmp_path / "rig.yaml")]
    done = subprocess.run(child, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    assert here.depth is not None
    assert done.stdout.strip() == hashlib.sha256(here.bgr.tobytes() + here.depth.tobytes()).hexdigest()


def test_without_depth_and_without_markers(opened: Open) -> None:
    camera = opened("depth: false, markers: false, noise: 0, blur_px: 0, fps: 200")
    assert camera.describe().depth_unit_mm is None
    frame = camera.grab(5.0)
    assert frame.depth is None
    bright = take(opened("noise: 0, blur_px: 0, fps: 200"), 1)[0]
    changed = (frame.bgr != bright.bgr).any(axis=2)
    assert bright.truth is not None
    visible = [np.array(marker.corners) for marker in bright.truth[0].markers if marker.visible]
    assert changed.any() == bool(visible)
    assert frame.truth == bright.truth


def test_a_calibration_decides_size_and_lens(tmp_path: Path) -> None:
    (tmp_path / "cam.yaml").write_text(CALIBRATION)
    (tmp_path / "rig.yaml").write_text(f"{OBJECTS}cameras:\n  cam0: {{driver: synthetic, calibration: cam.yaml}}\n")
    rig = load_rig(tmp_path / "rig.yaml")
    camera = open_camera("cam0", rig.camera("cam0"), rig)
    model = CameraModel.from_label(camera.describe().camera)
    np.testing.assert_array_equal(model.matrix, [[120, 0, 79], [0, 121, 44], [0, 0, 1]])
    assert camera.grab(5.0).bgr.shape == (90, 160, 3)


def test_a_calibration_of_another_size_is_scaled_and_said_so(tmp_path: Path) -> None:
    (tmp_path / "cam.yaml").write_text(CALIBRATION)
    keys = "driver: synthetic, width: 320, height: 180, calibration: cam.yaml"
    (tmp_path / "rig.yaml").write_text(f"{OBJECTS}cameras:\n  cam0: {{{keys}}}\n")
    rig = load_rig(tmp_path / "rig.yaml")
    told = open_camera("cam0", rig.camera("cam0"), rig).describe()
    assert told.camera.matrix[0] == (240.0, 0.0, 158.5)
    assert "scaled by 2.000" in told.warnings[0]


def test_a_lens_without_distortion_and_an_even_light(opened: Open) -> None:
    plain = opened("distortion: [], light: 0, clutter: 0, fps: 200")
    assert plain.describe().camera.distortion == (0.0,) * 5
    matrix = np.array(plain.describe().camera.matrix)
    frame, full = plain.grab(5.0), opened("distortion: [], fps: 200").grab(5.0)
    assert frame.truth is not None
    (true,) = frame.truth
    corner = Pose.from_rvec(true.rvec, true.tvec_mm).apply([-200.0, -150.0, 150.0])[0]
    assert np.allclose((matrix @ corner)[:2] / corner[2], true.corners[0])
    assert frame.truth == full.truth
    assert not np.array_equal(frame.bgr, full.bgr)


@pytest.mark.parametrize("keys", ["noise: -1", "frames: 0", "colour: red", "distortion: [0.1, 0.2]", "light: 2"])
def test_a_wrong_key_is_named(opened: Open, keys: str) -> None:
    with pytest.raises(ConfigError) as caught:
        opened(keys)
    assert keys.split(":")[0] in " ".join([caught.value.message, *caught.value.problems])
