"""An Azure Kinect's recording: its calibration read right, its depth where colour sees it."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from common.config import load_rig
from common.errors import CameraError, ConfigError
from common.geometry import CameraModel
from services.capture.cameras.azure_calibration import AzureCalibration, Reprojection, read_calibration
from services.capture.cameras.azure_recording import AzureSource
from services.capture.cameras.files import FilesCamera
from services.capture.cameras.nearest import Nearest

RECORDING, CALIBRATION = "recordings/azure_kinect.mkv", "recordings/azure_kinect_calibration.json"
Find = Callable[[str], Path]


def flat(width: int, height: int, focal: float) -> CameraModel:
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return CameraModel(width, height, matrix, np.zeros(5))


def side_by_side(offset_mm: float) -> Reprojection:
    """Colour of twice the resolution, ``offset_mm`` to the right of depth."""
    return Reprojection(
        AzureCalibration(flat(160, 120, 200.0), flat(80, 60, 100.0), np.eye(3), np.array([-offset_mm, 0.0, 0.0]))
    )


def test_a_wall_is_moved_by_its_parallax() -> None:
    depth = np.full((60, 80), 1000, np.uint16)
    aligned = side_by_side(50.0).align(depth)
    moved = round(50.0 * 200 / 1000)
    assert aligned.dtype == np.uint16
    assert (aligned[:, : 160 - moved - 1] == 1000).all(), "no cracks"
    assert not aligned[:, 160 - moved + 1 :].any(), "nothing is known where only colour looks"


def test_the_nearest_wins_and_unknown_stays_unknown() -> None:
    depth = np.full((60, 80), 2000, np.uint16)
    depth[20:40, 30:50] = 500
    depth[:10] = 0
    aligned = side_by_side(50.0).align(depth)
    assert set(np.unique(aligned)) == {0, 500, 2000}
    assert not aligned[:18].any()
    # The near square: 30..50 of 80 pixels are 60..100 of 160, moved by 20.
    assert (aligned[42:78, 42:78] == 500).all()
    # Behind its right edge lies what only colour sees: wall moves by 5, the square by 20.
    assert not aligned[45:75, 83:94].any()
    assert (aligned[45:75, 97:150] == 2000).all()


def test_cameras_that_look_alike_change_nothing() -> None:
    camera = flat(80, 60, 100.0)
    same = Reprojection(AzureCalibration(camera, camera, np.eye(3), np.zeros(3)))
    depth = np.random.default_rng(1).integers(900, 902, (60, 80)).astype(np.uint16)
    aligned = same.align(depth)
    assert (np.abs(aligned.astype(int) - depth) <= 1).all()


def test_the_real_recording(testdata: Find, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        f"cameras:\n  cam0: {{driver: files, pace: consumer, path: {testdata(RECORDING)}}}\n"
    )
    rig = load_rig(tmp_path / "rig.yaml")
    camera = FilesCamera("cam0", rig.camera("cam0"), rig)
    about = camera.describe()
    assert (about.camera.serial, about.camera.intrinsics_from, about.depth_unit_mm) == ("001514394512", "factory", 1.0)
    grabbed = camera.grab(1.0)
    assert grabbed.bgr.shape == (720, 1280, 3)
    assert grabbed.depth is not None
    assert grabbed.depth.shape == (720, 1280)
    assert 0.5 < (grabbed.depth > 0).mean() < 0.7
    assert grabbed.device_ns == 463_945_000 + 336_277_000, "the camera's own clock"
    camera.close()


def test_its_depth_lies_where_opencv_projects_it(testdata: Find) -> None:
    """The way of single points, from the file's numbers by hand through cv2, against the aligned picture."""
    cameras = json.loads(testdata(CALIBRATION).read_text())["CalibrationInformation"]["Cameras"]
    depth, colour = sorted(cameras, key=lambda one: one["Location"])
    with av.open(str(testdata(RECORDING))) as container:
        raw = next(container.decode(container.streams.video[1])).to_ndarray().astype(np.uint16)

    def by_hand(camera: dict, binned: tuple[int, int], cut: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        p = camera["Intrinsics"]["ModelParameters"]
        cx, cy = p[0] * binned[0] - cut[0] - 0.5, p[1] * binned[1] - cut[1] - 0.5
        matrix = np.array([[p[2] * binned[0], 0, cx], [0, p[3] * binned[1], cy], [0, 0, 1]])
        return matrix, np.array([p[4], p[5], p[13], p[12], p[6], p[7], p[8], p[9]])

    depth_matrix, depth_lens = by_hand(depth, (1024, 1024), (192, 180))
    colour_matrix, colour_lens = by_hand(colour, (1280, 960), (0, 120))
    v, u = np.nonzero(raw)
    pick = np.random.default_rng(3).choice(len(u), 4000, replace=False)
    u, v = u[pick], v[pick]
    rays = cv2.undistortPoints(np.column_stack([u, v]).astype(float)[:, None], depth_matrix, depth_lens)[:, 0]
    points = np.column_stack([rays, np.ones(len(rays))]) * raw[v, u][:, None]
    place = colour["Rt"]
    moved = points @ np.array(place["Rotation"]).reshape(3, 3).T + 1000 * np.array(place["Translation"])
    seen = cv2.projectPoints(moved, np.zeros(3), np.zeros(3), colour_matrix, colour_lens)[0][:, 0]
    at = np.rint(seen).astype(int)
    inside = (at >= 0).all(axis=1) & (at < [1280, 720]).all(axis=1)
    source = AzureSource(testdata(RECORDING))
    frame = source.read()
    assert frame is not None
    assert frame.depth is not None
    found = frame.depth[at[inside, 1], at[inside, 0]].astype(float)
    expected = moved[inside, 2]
    assert (found > 0).all()
    assert (found <= expected + 1).all(), "what is nearer may cover it, nothing farther can"
    assert np.mean(np.abs(found - expected) < 0.01 * expected) > 0.93, "the rest is covered by what is nearer"
    assert source.recorded.camera is not None
    assert np.allclose(source.recorded.camera.matrix, colour_matrix)
    assert np.allclose(source.recorded.camera.distortion, colour_lens)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"{}", "KeyError 'CalibrationInformation'"),
        (b"no json", "JSONDecodeError"),
        (None, "there is no mode of 640x480 pixels"),
    ],
)
def test_a_calibration_that_does_not_fit_is_told(testdata: Find, text: bytes | None, told: str) -> None:
    given = testdata(CALIBRATION).read_bytes() if text is None else text
    with pytest.raises(CameraError, match=f"calibration can't be read: .*{told}"):
        read_calibration(given, (640, 480), (640, 576))


def test_an_early_calibration_of_the_sensors_middle_is_the_same_camera(testdata: Find) -> None:
    text = json.loads(testdata(CALIBRATION).read_text())
    now = read_calibration(json.dumps(text).encode(), (1280, 720), (640, 576)).colour
    (colour,) = (one for one in text["CalibrationInformation"]["Cameras"] if one["Location"].endswith("PV0"))
    numbers = colour["Intrinsics"]["ModelParameters"]
    colour["SensorHeight"] = 2304
    numbers[1], numbers[3] = (numbers[1] * 3072 - 384) / 2304, numbers[3] * 3072 / 2304
    early = read_calibration(json.dumps(text).encode(), (1280, 720), (640, 576)).colour
    assert np.allclose(early.matrix, now.matrix)


def test_files_that_only_look_like_one_are_told(tmp_path: Path, testdata: Find) -> None:
    fake = tmp_path / "fake.mkv"
    fake.write_bytes(b"K4A_ and nothing else" * 10)
    with pytest.raises(CameraError, match=r"fake\.mkv can't be read as a video"):
        AzureSource(fake)
    with av.open(str(fake), "w") as container:
        stream = container.add_stream("mjpeg", rate=5)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        stream.metadata["title"] = "COLOR"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="bgr24")))
        container.mux(stream.encode())
    with pytest.raises(CameraError, match=r"lacks its calibration \(calibration\.json\)"):
        AzureSource(fake)


def test_without_pyav_it_says_what_to_install(tmp_path: Path, testdata: Find, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rig.yaml").write_text(f"cameras:\n  cam0: {{driver: files, path: {testdata(RECORDING)}}}\n")
    rig = load_rig(tmp_path / "rig.yaml")
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "services.capture.cameras.file_opening.find_spec", lambda name: None if name == "av" else found(name)
    )
    with pytest.raises(ConfigError, match=r"Azure Kinect recording, which needs the package av; pip install"):
        FilesCamera("cam0", rig.camera("cam0"), rig)


def test_pairs_are_the_nearest_in_time_and_none_is_lost() -> None:
    stream = Nearest(iter([(0, "a"), (30, "b"), (65, "c"), (200, "d")]))
    asked = [(1, "a"), (33, "b"), (48, None), (66, "c"), (100, None), (199, "d"), (215, "d"), (400, None)]
    assert [stream.at(ns, 16) for ns, _ in asked] == [item for _, item in asked]
    assert Nearest(iter(())).at(0, 10) is None
