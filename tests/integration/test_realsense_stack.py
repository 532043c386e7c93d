"""A RealSense recording of a rendered scene through `tagmill up`: labels and depth against the renderer's truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from common.config import Rig, load_rig
from common.dataset import SessionReader
from common.geometry import CameraModel, Pose
from common.labels import Label
from common.markers import family
from common.messages import TrueObject
from common.scene import Scene, SceneCamera
from services.capture.cameras.realsense_geometry import camera_model
from tests.support.hygiene import Place
from tests.support.realsense_recordings import Build, Lens, record
from tests.support.stack import wait_for
from tests.support.supervised import DEADLINE_S, NO_PAGE, check_session, supervised
from tools.report.compare import compare

pytestmark = [pytest.mark.process, pytest.mark.timeout(300)]

FRAMES = 10
STEP = 15
"""Frames of the scene's path from one to the next: half a second."""
GRAZING_DEG = 85
"""A marker seen from further aside is narrower than the 5x5 pixels around its centre."""
TO_COLOUR = Pose.from_rvec(np.array([0.004, -0.006, 0.003]), np.array([15.0, 0.2, 0.4]))
"""Depth camera to colour camera, as far apart as in a D435."""
BUILD = Build(
    colour=Lens(1280, 720, 910.0, "inverse_brown_conrady", (-0.0557, 0.0668, -0.0004, 0.0007, -0.0216)),
    depth=Lens(1280, 720, 640.0),
    serial="031422250001",
    rotation=TO_COLOUR.rotation,
    translation_mm=tuple(TO_COLOUR.translation),
)
RIG = f"""\
dataset: {{root: ./dataset, session: realsense}}
{NO_PAGE}
cameras:
  cam0: {{driver: realsense, recording: scene.db3, pace: consumer}}
"""


def render(rig: Rig, path: Path) -> list[tuple[TrueObject, ...]]:
    """Record the scene as both eyes of a RealSense see it; the truth of each frame in the colour camera."""
    scene = Scene(rig.boxes, family(rig.config.markers.family, rig.folder), seed=3)
    assert BUILD.depth is not None
    colour = SceneCamera(scene, camera_model(BUILD.colour.intrinsics()))
    depth = SceneCamera(scene, camera_model(BUILD.depth.intrinsics()))
    frames, truths = [], []
    for index in range(0, FRAMES * STEP, STEP):
        poses = colour.poses(index)
        seen = colour.render(index, poses, depth=False)
        measured = depth.render(index, {name: TO_COLOUR.inverse().after(pose) for name, pose in poses.items()})
        frames.append((seen.bgr, measured.depth))
        truths.append(seen.truth)
    record(path, frames, BUILD)
    return truths


def marker_centres(rig: Rig, truth: tuple[TrueObject, ...]) -> dict[int, np.ndarray]:
    """Centre of each visible marker in the camera frame, mm; without those that are seen edge-on."""
    boxes = {box.name: box for box in rig.boxes}
    centres = {}
    for item in truth:
        pose = Pose.from_rvec(np.array(item.rvec), np.array(item.tvec_mm))
        visible = {marker.id for marker in item.markers if marker.visible}
        for side, marker in boxes[item.name].markers():
            if marker.id in visible:
                placed = pose.after(boxes[item.name].marker_pose(side, marker))
                sight = placed.translation / np.linalg.norm(placed.translation)
                if -sight @ placed.rotation[:, 2] > np.cos(np.radians(GRAZING_DEG)):
                    centres[marker.id] = placed.translation
    return centres


def test_labels_and_depth_of_a_realsense_recording_are_true(tmp_path: Path, place: Place) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    rig = load_rig(path)
    truths = render(rig, tmp_path / "scene.db3")
    with supervised(path, "cam0") as stack:
        started = stack.ask(command="start", camera="cam0")
        assert started["ok"], started

        def ended() -> bool:
            known = stack.status()["recordings"].get(started["recording"])
            return bool(known and known["phase"] == "ended")

        wait_for(ended, 2 * DEADLINE_S, "the recording to end")
        ledger = stack.ask(command="ledger", recording=started["recording"])["ledger"]["cameras"]["cam0"]
        status = stack.status()["cameras"]["cam0"]
    assert ledger["captured"] == ledger["recorded"] == FRAMES, ledger
    assert status["driver"] == "realsense"
    session = tmp_path / "dataset" / "realsense"
    check_session(session)
    reader = SessionReader(session)
    labels = [reader.label(name) for name in reader.samples()]
    assert [label.source_name for label in labels] == [f"scene.db3#{number}" for number in range(FRAMES)]
    check_camera(labels[0])
    apart: list[float] = []
    off: list[float] = []
    for label, truth in zip(labels, truths, strict=True):
        assert len(label.objects) == 1
        (difference,) = compare(label.objects, truth)
        assert difference.iou > 0.98
        assert abs(difference.distance_mm) < 0.005 * difference.true_distance_mm
        apart.append(difference.corner_px)
        off += depth_errors(reader.depth(label), label, marker_centres(rig, truth))
    assert np.median(apart) < 0.5
    assert len(off) >= FRAMES, "markers in view"
    assert max(map(abs, off)) < 0.01, "depth at a marker's centre and z of that centre"


def check_camera(label: Label) -> None:
    assert label.depth is not None
    assert label.depth.unit_mm == 1.0
    assert (label.camera.serial, label.camera.intrinsics_from) == ("031422250001", "factory")
    assert (label.camera.width, label.camera.height) == (1280, 720)


def depth_errors(depth: Any, label: Label, centres: dict[int, np.ndarray]) -> list[float]:
    """Share by which the depth at each marker's centre (median of 5x5) differs from that centre's z."""
    model = CameraModel.from_label(label.camera)
    errors = []
    for centre in centres.values():
        (u, v) = np.round(model.project(centre)[0][0]).astype(int)
        patch = depth[v - 2 : v + 3, u - 2 : u + 3]
        assert (patch > 0).all()
        errors.append(float(np.median(patch)) / centre[2] - 1)
    assert cv2.countNonZero(depth) > 0.5 * depth.size
    return errors
