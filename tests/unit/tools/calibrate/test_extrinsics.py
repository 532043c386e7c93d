"""`tagmill calibrate extrinsics`: a session of two cameras with known relative pose, and what is taken live."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.boards import Board
from common.bus import Endpoints
from common.calibration import BoardFinder, View
from common.calibration.extrinsics import relative_pose
from common.config import Rig, load_rig, read_extrinsics
from common.config.models import NetworkConfig
from common.geometry import CameraModel, Pose
from common.labels import CameraLabel, Label, PairLabel
from common.markers import family
from common.scene import Scene, SceneCamera
from common.scene.boards import HOLD_FRAMES, MOVE_FRAMES
from tests.support.samples import camera_label, label_for, object_label
from tests.support.sessions import make_session
from tools.calibrate.pairs import LivePairs
from tools.cli import main

RIG = """\
# mine: keep this line
objects:
  - name: box-0
    size_mm: {width: 400, height: 300, depth: 300}
    sides:
      front: {marker: 0, marker_size_mm: 150}
      left:  {marker: 1, marker_size_mm: 150}
      top:   {marker: 2, marker_size_mm: 150}
cameras:
  cam0: {driver: synthetic}
  cam1: {driver: synthetic, view: -20}
"""
TRUE = Pose.from_rvec([0.02, 0.3, -0.01], [-420.0, 15.0, 60.0])
"""cam1's frame to cam0's."""
OBJECT = Pose.from_rvec(cv2.Rodrigues(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]))[0].ravel(), [0.0, 0, 0])
"""A box that stands upright, its front to the camera."""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return path


def labels(rig: Rig, count: int, rng: np.random.Generator, offset_ms: float = 2.0) -> list[Label]:
    box, out = rig.boxes[0], []
    cameras = {name: camera_label(name, 900.0, 1280, 720) for name in ("cam0", "cam1")}
    for number in range(count):
        turn = Pose.from_rvec(rng.uniform([-0.1, 0.1, -0.4], [0.7, 0.9, 0.4]), np.zeros(3))
        at = Pose(np.eye(3), np.array([*rng.uniform(-250, 250, 2), rng.uniform(1200, 2000)]))
        placed = {"cam0": at.after(turn.after(OBJECT))}
        placed["cam1"] = TRUE.inverse().after(placed["cam0"])
        names = {name: label_for(2 * number + index).sample for index, name in enumerate(cameras)}
        for index, (name, camera) in enumerate(cameras.items()):
            model = CameraModel.from_label(camera)
            sides = []
            for side, marker in box.markers():
                pixels, _ = model.project(placed[name].apply(box.marker_corners(side, marker)))
                corners = [tuple(map(float, point)) for point in pixels + rng.normal(0, 0.1, (4, 2))]
                given = object_label().sides[0].model_dump(by_alias=True)
                sides.append(given | {"marker": marker.id, "face": side.face, "marker_corners": corners})
            thing = object_label().model_dump(by_alias=True)
            thing |= {"sides": sides, "pose": placed[name].label().model_dump(), "name": "box-0"}
            pair = PairLabel(reference="cam0", offset_ms=index * offset_ms, spread_ms=offset_ms, samples=names)
            whole = label_for(2 * number + index).model_dump(by_alias=True)
            whole |= {"camera": camera.model_dump(), "objects": [thing], "pair": pair.model_dump()}
            out.append(Label.model_validate(whole | {"sample": names[name]}))
    return out


def measured(rig: Path, *words: str, code: int = 0) -> list[str]:
    words = ("calibrate", "extrinsics", "--rig", str(rig), "--cameras", "cam0,cam1", *words)
    assert main(list(words)) == code
    return list(words)


def answered(capsys: pytest.CaptureFixture[str], rig: Path, *words: str, code: int = 0) -> dict[str, Any]:
    measured(rig, *words, "--json", code=code)
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_a_session_gives_the_relative_pose_within_its_deviations(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_session(tmp_path / "session", *labels(load_rig(rig), 12, np.random.default_rng(5)))
    told = answered(capsys, rig, "--session", str(tmp_path / "session"))
    assert told["named_in_rig"] is False
    path = tmp_path / "calibration" / "extrinsics.yaml"
    assert told["file"] == str(path)
    found = read_extrinsics(path)["cam1"]
    assert (found.to, found.pairs) == ("cam0", 12)
    assert (np.abs(np.array(found.tvec_mm) - TRUE.translation) < 3 * np.array(found.sd_mm)).all()
    turn = cv2.Rodrigues(Pose.from_rvec(found.rvec, [0, 0, 0]).rotation @ TRUE.rotation.T)[0].ravel()
    assert (np.abs(np.degrees(turn)) < 3 * np.array(found.sd_rotation_deg)).all()
    assert max(found.sd_mm) < 5
    assert rig.read_text() == RIG  # what to add is told, the file stays as it is


def test_the_rig_names_the_file_and_has_what_is_in_it(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_session(tmp_path / "session", *labels(load_rig(rig), 5, np.random.default_rng(6)))
    measured(rig, "--session", str(tmp_path / "session"))
    said = capsys.readouterr().out
    assert "cam1 stands 42" in said
    assert f"to use it, write `extrinsics: calibration/extrinsics.yaml` into {rig}" in said
    rig.write_text(RIG + "extrinsics: calibration/extrinsics.yaml\n")
    loaded = load_rig(rig)
    assert loaded.extrinsics["cam1"].to == "cam0"
    assert loaded.warnings == ()
    assert answered(capsys, rig, "--session", str(tmp_path / "session"))["named_in_rig"] is True


def test_mistakes_in_the_file_are_told_where_the_rig_names_it(rig: Path) -> None:
    rig.write_text(RIG + "extrinsics: nowhere.yaml\n")
    assert main(["check", str(rig)]) == 78
    (rig.parent / "nowhere.yaml").write_text("cam1: {to: cam0, rvec: [0, 0], tvec_mm: [1, 2, 3]}\n")
    assert main(["check", str(rig)]) == 78


def test_samples_taken_too_far_apart_are_left_out(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_session(tmp_path / "session", *labels(load_rig(rig), 4, np.random.default_rng(7), offset_ms=14.0))
    told = answered(capsys, rig, "--session", str(tmp_path / "session"), code=3)
    assert told["error"]["code"] == "no_views"
    assert not (tmp_path / "calibration").exists()
    answered(capsys, rig, "--session", str(tmp_path / "session"), "--within-ms", "20")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--cameras", "cam0"], 78, "two or more different cameras"),
        (["--board", "chessboard", "--size", "9x6", "--square-mm", "25"], 3, "start the stack with `tagmill up"),
        (["--session", "nowhere"], 3, "nowhere"),
    ],
)
def test_mistakes(rig: Path, words: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said in answered(capsys, rig, *words, code=code)["error"]["message"]


def test_live_pairs_are_taken_of_a_board_that_is_still_and_new() -> None:
    board = Board(kind="charuco", columns=8, rows=6, square_mm=30, marker_mm=22, family="5x5_250")
    model = CameraModel(640, 480, np.array([[460.0, 0, 319.5], [0, 460.0, 239.5], [0, 0, 1]]), np.zeros(5))
    scene = Scene((), family("apriltag_36h11", Path()), 2, frustum=(0.55, 0.42), board=board)
    cameras = [SceneCamera(scene, model, view_deg=angle) for angle in (0.0, -12.0)]
    live = LivePairs(board, Endpoints.of(NetworkConfig()), "cam0", "cam1")
    label = CameraLabel.model_validate(
        {"name": "cam0", "width": 640, "height": 480, "matrix": model.matrix.tolist(), "distortion": [0.0] * 5}
    )
    live.seen.cameras = [label, label]
    finder, said = BoardFinder(board), []
    for stop in range(9):
        for index in (0, 3, 6):
            views = [
                finder.find(camera.render(stop * (HOLD_FRAMES + MOVE_FRAMES) + index, depth=False).bgr, "x")
                for camera in cameras
            ]
            both = views[0], views[1]
            said.append(live.offer(both if isinstance(both[0], View) and isinstance(both[1], View) else None))  # type: ignore[arg-type]
    assert 4 <= len(live.seen.pairs) <= 9
    assert len(said) == 27
    found = relative_pose(live.seen.pairs, model, model)
    expected = scene.viewpoint(0.0).after(scene.viewpoint(-12.0).inverse())
    assert np.linalg.norm(found.pose.translation - expected.translation) < 4 * np.linalg.norm(found.sd_mm)
    assert np.degrees(found.pose.angle_to(expected)) < 0.2
