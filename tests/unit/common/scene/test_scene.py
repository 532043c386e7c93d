"""What a scene promises: the same frame for the same numbers, honest visibility, a path that can be used."""

from __future__ import annotations

import subprocess
import sys
import zlib
from itertools import pairwise

import cv2
import numpy as np
import pytest

from common.geometry import Box, BoxSide, CameraModel, MarkerOnSide, Pose
from common.markers import Family
from common.scene import Scene, SceneCamera
from tests.support.april_tags import april_tags
from tests.unit.common.scene.conftest import DISTORTION, MATRIX, camera, carton, plate

UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
ALL_FACES = ("front", "right", "back", "left", "top")


@pytest.fixture(scope="module")
def pair(tags: Family) -> SceneCamera:
    return SceneCamera(Scene([carton("a", 0), carton("b", 10)], tags, seed=4), camera())


def facing(x: float, y: float, z: float) -> Pose:
    return Pose(UPRIGHT, np.array([x, y, z]))


def checksum(scene_camera: SceneCamera, index: int) -> int:
    rendered = scene_camera.render(index)
    assert rendered.depth is not None
    return zlib.crc32(rendered.depth.tobytes(), zlib.crc32(rendered.bgr.tobytes()))


def test_a_frame_follows_from_seed_and_index(pair: SceneCamera, tags: Family) -> None:
    again = SceneCamera(Scene([carton("a", 0), carton("b", 10)], tags, seed=4), camera())
    again.render(99)  # what was asked before doesn't matter
    assert checksum(pair, 17) == checksum(again, 17)
    assert checksum(pair, 17) != checksum(pair, 18)
    other = SceneCamera(Scene([carton("a", 0), carton("b", 10)], tags, seed=5), camera())
    assert checksum(other, 17) != checksum(pair, 17)


def test_another_process_renders_the_same(pair: SceneCamera) -> None:
    program = (
        "from pathlib import Path\n"
        "from common.markers import family\n"
        "from common.scene import Scene, SceneCamera\n"
        "from tests.unit.common.scene.conftest import camera, carton\n"
        "from tests.unit.common.scene.test_scene import checksum\n"
        "tags = family('apriltag_36h11', Path())\n"
        "print(checksum(SceneCamera(Scene([carton('a', 0), carton('b', 10)], tags, seed=4), camera()), 17))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=100, check=True)
    assert int(done.stdout) == checksum(pair, 17)


def test_without_markers_only_the_stickers_differ(pair: SceneCamera) -> None:
    for index in (0, 60, 200):
        marked, plain = pair.render(index), pair.render(index, markers=False)
        assert marked.truth == plain.truth
        allowed = np.zeros((480, 640), np.uint8)
        for box in pair.scene.boxes:
            pose = pair.poses(index)[box.name]
            for side, marker in box.markers():
                quad = pose.apply(box.marker_corners(side, marker, marker.border_mm))
                pixels, _ = cv2.projectPoints(quad, np.zeros(3), np.zeros(3), MATRIX, DISTORTION)
                cv2.fillConvexPoly(allowed, np.rint(pixels).astype(np.int32), 1)
        allowed = cv2.dilate(allowed, np.ones((9, 9), np.uint8))  # the blur's reach, half a pixel of edge, rounding
        differs = (marked.bgr != plain.bgr).any(axis=2)
        assert differs.any()
        assert not differs[allowed == 0].any()
        assert (marked.depth == plain.depth).all()


def test_no_detector_finds_a_marker_where_none_is(pair: SceneCamera) -> None:
    grey = [cv2.cvtColor(pair.render(i * 50, markers=False).bgr, cv2.COLOR_BGR2GRAY) for i in range(6)]
    assert april_tags(grey) == [[]] * 6
    for name in ("DICT_APRILTAG_36H11", "DICT_4X4_50", "DICT_5X5_1000", "DICT_6X6_250"):
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
        assert all(detector.detectMarkers(picture)[1] is None for picture in grey)


def test_visible_markers_are_found_and_others_are_not(tags: Family) -> None:
    scene = Scene([carton("a", 0, ALL_FACES, 90.0), carton("b", 10, ALL_FACES, 90.0)], tags, seed=4, distance_mm=900)
    scene_camera = SceneCamera(scene, camera())
    detector = cv2.aruco.ArucoDetector(tags.dictionary)
    wanted = found = 0
    for index in range(0, 600, 40):
        rendered = scene_camera.render(index, noise=0)
        _, ids, _ = detector.detectMarkers(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY))
        seen = set() if ids is None else {int(i) for i in ids.ravel()}
        markers = [marker for thing in rendered.truth for marker in thing.markers]
        assert seen <= {marker.id for marker in markers if marker.visible}
        upright = {m.id for m in markers if m.visible and cv2.contourArea(np.array(m.corners, np.float32)) > 900}
        wanted += len(upright)
        found += len(upright & seen)
    assert wanted > 20
    assert found >= 0.9 * wanted


def test_visible_needs_the_front_and_the_whole_square_in_the_picture(tags: Family) -> None:
    scene = Scene([carton("a", 0)], tags, clutter=0.0)

    def visible(pose: Pose) -> dict[int, bool]:
        (truth,) = scene.render(CAMERA, {"a": pose}, depth=False, noise=0).truth
        return {marker.id: marker.visible for marker in truth.markers}

    # Front 0, left 1, top 2; straight ahead only the front is seen.
    assert visible(facing(0, 0, 600)) == {0: True, 1: False, 2: False}
    # To the right and below the axis its left side and its top come into view.
    assert visible(facing(250, 150, 800)) == {0: True, 1: True, 2: True}
    # From behind: nothing.
    behind = Pose(UPRIGHT @ np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 0, 600]))
    assert visible(behind) == {0: False, 1: False, 2: False}
    # Half of the front's marker beyond the picture's edge: at z = 500 half the picture is 266 mm wide.
    assert visible(facing(266, 0, 600)) == {0: False, 1: True, 2: False}


CAMERA = camera()


@pytest.mark.parametrize("nearer", ["a", "b"])
def test_the_nearer_box_hides_the_farther_one(tags: Family, nearer: str) -> None:
    farther = "b" if nearer == "a" else "a"
    scene = Scene([carton("a", 0), carton("b", 10)], tags, clutter=0.0)
    poses = {nearer: facing(30, 10, 600), farther: facing(-10, 0, 900)}
    rendered = scene.render(CAMERA, poses, depth_noise_mm=0)
    assert rendered.depth is not None
    truths = {thing.name: thing for thing in rendered.truth}
    assert truths[nearer].markers[0].visible
    assert not truths[farther].markers[0].visible
    x, y = np.array(truths[nearer].markers[0].corners).mean(axis=0).round().astype(int)
    assert rendered.depth[y, x] == 500
    alone = scene.render(CAMERA, {nearer: poses[nearer]}, depth_noise_mm=0)
    inside = rendered.depth == alone.depth
    window = truths[nearer].window
    middle = np.s_[int(window.y_min) + 8 : int(window.y_max) - 8, int(window.x_min) + 8 : int(window.x_max) - 8]
    assert inside[middle].all()
    assert (rendered.bgr[middle] == alone.bgr[middle]).all()


def test_a_long_box_beside_a_small_one_is_drawn_in_the_right_order(tags: Family) -> None:
    """The long one's centre is nearer, yet the small one stands before its far end."""
    long = Box("long", "shelf", (100.0, 120.0, 1600.0), ())
    small = plate(MarkerOnSide(5, 80.0, 10.0), "small")
    scene = Scene([small, long], tags, clutter=0.0)
    # The long box lies along the line of sight, at the left; the small one is behind its centre and beside it.
    poses = {"long": facing(-120, 60, 1000), "small": facing(90, 60, 1100)}
    for boxes in ((small, long), (long, small)):
        rendered = Scene(boxes, tags, clutter=0.0).render(CAMERA, poses, depth_noise_mm=0)
        (truth,) = (thing for thing in rendered.truth if thing.name == "small")
        assert truth.markers[0].visible
        x, y = np.array(truth.markers[0].corners).mean(axis=0).round().astype(int)
        assert rendered.depth is not None
        assert rendered.depth[y, x] == 1098
    del scene


def test_a_camera_elsewhere_sees_the_same_things(tags: Family) -> None:
    """Relative poses are kept, and its pixels agree with its truth."""
    scene = Scene([carton("a", 0, ALL_FACES, 80.0), carton("b", 10, ALL_FACES, 80.0)], tags, seed=2)
    cameras = {angle: SceneCamera(scene, CAMERA, view_deg=angle) for angle in (0.0, 30.0)}
    index = 120
    relative = []
    for scene_camera in cameras.values():
        poses = scene_camera.poses(index)
        relative.append(poses["a"].inverse().after(poses["b"]).matrix)
    assert np.allclose(relative[0], relative[1])
    assert not np.allclose(cameras[0.0].poses(index)["a"].matrix, cameras[30.0].poses(index)["a"].matrix)
    rendered = cameras[30.0].render(index, noise=0)
    detector = cv2.aruco.ArucoDetector(tags.dictionary)
    corners, ids, _ = detector.detectMarkers(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY))
    assert ids is not None
    true = {marker.id: np.array(marker.corners) for thing in rendered.truth for marker in thing.markers}
    errors = [
        np.linalg.norm(quad.reshape(4, 2)[[2, 3, 0, 1]] - true[int(tag)], axis=1)
        for quad, tag in zip(corners, ids.ravel(), strict=True)
    ]
    assert np.median(errors) < 1.0  # unrefined corners; at a grazing angle single ones are worse
    assert scene.viewpoint(90.0).apply([0, 0, 0])[0, 0] != 0.0


def test_going_round_to_the_right_shows_the_scene_from_the_right(tags: Family) -> None:
    scene = Scene([carton("a", 0)], tags)
    middle = [0.0, 0.0, scene.room.middle]
    assert np.allclose(scene.viewpoint(40.0).apply(middle), middle)
    place = scene.viewpoint(40.0).inverse().apply([0.0, 0.0, 0.0])[0]
    assert place[0] > 0
    assert np.linalg.norm(place - middle) == pytest.approx(scene.room.middle)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_objects_on_their_path_stay_in_the_picture_and_apart(tags: Family, count: int) -> None:
    boxes = [carton(f"box-{i}", 10 * i, ALL_FACES) for i in range(count)]
    scene = Scene(boxes, tags, seed=11, frustum=(320 / 600, 240 / 600))
    radius = np.linalg.norm([240, 180, 200]) / 2
    corners_inside = corners = 0
    for index in range(0, 3000, 25):
        poses = scene.poses(index)
        centres = np.array([pose.translation for pose in poses.values()])
        assert CAMERA.contains(CAMERA.project(centres)[0]).all()
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + 1e9 * np.eye(count)
        assert apart.min() > 2 * radius * 0.99
        for box in boxes:
            inside = CAMERA.contains(CAMERA.project(poses[box.name].apply(box.corners))[0])
            corners_inside += int(inside.sum())
            corners += 8
    assert corners_inside > 0.97 * corners


@pytest.mark.parametrize("faces", [("front",), ("front", "left", "top"), ALL_FACES, ("top",), ("front", "back")])
def test_a_marked_side_looks_at_the_camera_most_of_the_time(tags: Family, faces: tuple) -> None:
    box = carton("a", 0, faces)
    scene = Scene([box], tags, seed=3)
    angles = []
    for index in range(0, 3000, 20):
        pose = scene.poses(index)["a"]
        to_camera = [pose.after(box.marker_pose(side, marker)) for side, marker in box.markers()]
        cosines = [-(p.rotation[:, 2] @ p.translation) / np.linalg.norm(p.translation) for p in to_camera]
        angles.append(np.degrees(np.arccos(max(cosines))))
    share = np.mean(np.array(angles) < 60)
    # Between two opposite sides a box must turn through views in which neither is seen.
    assert share > (0.6 if faces == ("front", "back") else 0.95)


def test_the_path_is_smooth_and_reaches_near_and_far(tags: Family) -> None:
    scene = Scene([carton("a", 0, ALL_FACES)], tags, seed=3)
    poses = [scene.poses(index)["a"] for index in range(1500)]
    steps = [np.linalg.norm(b.translation - a.translation) for a, b in pairwise(poses)]
    turns = [np.degrees(b.angle_to(a)) for a, b in pairwise(poses)]
    assert max(steps) < 20
    assert max(turns) < 4
    distances = [np.linalg.norm(pose.translation) for pose in poses]
    assert max(distances) > 1.3 * min(distances)
    half = Scene([carton("a", 0, ALL_FACES)], tags, seed=3, speed=0.5)
    assert np.allclose(half.poses(100)["a"].matrix, scene.poses(50)["a"].matrix)


def test_a_box_given_too_near_is_still_drawn_and_apart(tags: Family) -> None:
    scene = Scene([carton("a", 0), carton("b", 10)], tags, distance_mm=350)
    for index in range(0, 500, 50):
        poses = scene.poses(index)
        assert np.linalg.norm(poses["a"].translation - poses["b"].translation) > 2 * np.linalg.norm([240, 180, 200]) / 2
    scene.render(CAMERA, index=10)


def test_an_object_that_reaches_behind_the_camera_has_no_truth(tags: Family) -> None:
    scene = Scene([carton("a", 0)], tags, clutter=0.0)
    assert scene.render(CAMERA, {"a": facing(150, 0, 50)}).truth == ()
    assert scene.render(CAMERA, {"a": facing(0, 0, -900)}).truth == ()
    assert scene.render(CAMERA, {}).truth == ()


def test_noise_has_the_asked_for_strength_and_no_bias(tags: Family) -> None:
    scene = Scene([], tags, clutter=0.0, light=0.0)
    scene_camera = SceneCamera(scene, CAMERA)
    clean = scene_camera.render(0, noise=0, depth_noise_mm=0)
    for sigma in (2.0, 5.0):
        noisy = scene_camera.render(0, noise=sigma, depth_noise_mm=sigma)
        for one, other in ((noisy.bgr, clean.bgr), (noisy.depth, clean.depth)):
            assert one is not None
            assert other is not None
            rest = one.astype(float) - other.astype(float)
            assert abs(rest.mean()) < 0.05 * sigma
            assert rest.std() == pytest.approx(np.hypot(sigma, np.sqrt(1 / 12)), rel=0.03)
    first, second = (scene_camera.render(i).bgr.astype(float) - clean.bgr for i in (1, 2))
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02


def test_sides_have_looks_of_their_own(tags: Family) -> None:
    """A red logo only at the back; left and right are alike; the light changes slowly."""
    box = Box("a", "carton", (240.0, 180.0, 240.0), (BoxSide("front", "front", (MarkerOnSide(0, 40.0, 5.0),)),))
    scene = Scene([box], tags, seed=6, clutter=0.0)
    turn = {"front": 0.0, "right": -90.0, "back": 180.0, "left": 90.0}
    pictures = {}
    for face, yaw in turn.items():
        pose = Pose(UPRIGHT @ Pose.from_rvec([0, 0, np.radians(yaw)], [0, 0, 0]).rotation, np.array([0, 0, 500.0]))
        bgr = scene.render(CAMERA, {"a": pose}, noise=0, depth=False, markers=False).bgr
        pictures[face] = bgr[150:330, 200:440].astype(float)
    red = {
        face: ((p[:, :, 2] > 1.6 * p[:, :, 1]) & (p[:, :, 2] > 1.6 * p[:, :, 0])).mean() for face, p in pictures.items()
    }
    assert red["back"] > 0.05
    assert max(red[face] for face in turn if face != "back") < 0.005

    def busy(picture: np.ndarray) -> float:
        return float(np.abs(cv2.Laplacian(picture.mean(axis=2), cv2.CV_64F)).mean())

    assert min(busy(pictures["front"]), busy(pictures["back"])) > 1.2 * max(
        busy(pictures["left"]), busy(pictures["right"])
    )


def test_any_camera_can_look(tags: Family) -> None:
    """Small, tall, fisheye, and one whose corners no ray leads to."""
    scene = Scene([carton("a", 0)], tags, seed=1)
    strong = CameraModel(
        320, 240, np.array([[150.0, 0, 160], [0, 150.0, 120], [0, 0, 1]]), np.array([-0.5, 0.1, 0, 0, 0])
    )
    fish = CameraModel(
        200, 320, np.array([[120.0, 0, 100], [0, 120.0, 160], [0, 0, 1]]), np.array([0.02, 0, 0, 0]), model="fisheye"
    )
    for model in (strong, fish, CameraModel.guess(16, 16)):
        rendered = scene.render(model)
        assert rendered.bgr.shape == (model.height, model.width, 3)
        assert rendered.bgr.flags.c_contiguous
        assert rendered.depth is not None
        assert rendered.depth.dtype == np.uint16
