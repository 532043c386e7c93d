"""Where things are in a rendered picture, measured on the picture, against cv2's projection and hand calculation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from common.geometry import CameraModel, MarkerOnSide, Pose
from common.markers import Family
from common.scene import Scene, SceneCamera
from tests.support.april_tags import april_tag_corners
from tests.unit.common.scene.conftest import DISTORTION, MATRIX, camera, plate, projected

FISHEYE = np.array([-0.03, 0.01, -0.004, 0.001])
CAMERAS = {
    "distorted": (DISTORTION, "pinhole"),
    "plain": (np.zeros(5), "pinhole"),
    "barrel": (np.array([-0.28, 0.09, 0.001, 0.0007, 0.0]), "pinhole"),
    "fisheye": (FISHEYE, "fisheye"),
}
# Object frame to camera frame: the front of an upright box looks at the camera.
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
MARKER = MarkerOnSide(7, 80.0, 16.0)
SURFACE_MM = 2.0
"""The plate is 4 mm thick: its front is this far before its centre."""


def posed(rvec: tuple[float, float, float], tvec: tuple[float, float, float]) -> Pose:
    return Pose(Pose.from_rvec(rvec, (0, 0, 0)).rotation @ UPRIGHT, np.array(tvec))


POSES = {
    "facing": posed((0, 0, 0), (13.3, -7.7, 420)),
    "tilted": posed((0.5, -0.6, 0.35), (-60, 20, 380)),
    "corner": posed((-0.2, 0.45, 0.7), (140, 90, 500)),
    "turned": posed((0.0, 0.0, 1.1), (-100, -80, 450)),
}


def seen_square(pose: Pose, size: float, distortion: np.ndarray, model: str, steps: int = 41) -> np.ndarray:
    """Points (4, steps, 2) px along the edges TL-TR, TR-BR, BR-BL, BL-TL of a square in the middle of the front.

    By hand: the front's normal is -Y, right is +X, up is +Z.
    """
    half = size / 2
    corners = np.array(
        [[-half, -SURFACE_MM, half], [half, -SURFACE_MM, half], [half, -SURFACE_MM, -half], [-half, -SURFACE_MM, -half]]
    )
    share = np.linspace(0, 1, steps)[:, None]
    edges = np.array([corners[i] * (1 - share) + corners[(i + 1) % 4] * share for i in range(4)])
    in_camera = edges.reshape(-1, 3) @ pose.rotation.T + pose.translation
    return projected(in_camera, distortion, model).reshape(4, steps, 2)


def edge_offsets(grey: np.ndarray, line: np.ndarray, reach: float) -> np.ndarray:
    """How far outside (px) the picture shows the edge between black (inside) and white along a line of points.

    The area under each cross profile says where its step is, whatever symmetric blur there is.
    """
    direction = np.gradient(line, axis=0)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    # Corners are clockwise in the picture, hence outside is to the left of the way.
    outwards = np.column_stack([direction[:, 1], -direction[:, 0]])
    t = np.linspace(-reach, reach, 241)
    points = line[:, None] + outwards[:, None] * t[None, :, None]
    profile = bilinear(grey, points)
    black, white = profile[:, :20].mean(axis=1), profile[:, -20:].mean(axis=1)
    share = (profile - black[:, None]) / (white - black)[:, None]
    return reach - np.trapezoid(share, t, axis=1)


def bilinear(grey: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values at points (..., 2) px; cv2.remap would round them to 1/32 px."""
    x, y = points[..., 0], points[..., 1]
    u, v = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = x - u, y - v
    grey = grey.astype(np.float64)
    top = grey[v, u] * (1 - a) + grey[v, u + 1] * a
    below = grey[v + 1, u] * (1 - a) + grey[v + 1, u + 1] * a
    return top * (1 - b) + below * b


@pytest.fixture(scope="module")
def plate_scene(tags: Family) -> Scene:
    return Scene([plate(MARKER)], tags, clutter=0.0, light=0.0)


@pytest.fixture(scope="module", params=sorted(CAMERAS))
def lens(request: pytest.FixtureRequest, plate_scene: Scene) -> tuple[SceneCamera, np.ndarray, str]:
    distortion, model = CAMERAS[request.param]
    return SceneCamera(plate_scene, camera(distortion, model)), distortion, model


@pytest.mark.parametrize("blur", [0.0, 0.6])
@pytest.mark.parametrize("name", sorted(POSES))
def test_marker_edges_are_where_cv2_projects_them(
    lens: tuple[SceneCamera, np.ndarray, str], name: str, blur: float
) -> None:
    scene_camera, distortion, model = lens
    rendered = scene_camera.render(0, {"plate": POSES[name]}, noise=0, blur_px=blur, depth=False)
    grey = rendered.bgr[:, :, 1]
    edges = seen_square(POSES[name], MARKER.size_mm, distortion, model)
    cell_px = min(np.linalg.norm(edge[-1] - edge[0]) for edge in edges) / 10
    for edge in edges:
        inner = edge[6:-6]
        offsets = edge_offsets(grey, inner, min(0.8 * cell_px, 6.0))
        # Unblurred, a profile between a pixel grid's points wavers; blurred, each single one is right.
        assert abs(offsets.mean()) < (0.01 if blur else 0.015)
        assert np.abs(offsets).max() < (0.025 if blur else 0.08)


def test_the_exact_quality_has_the_same_geometry(plate_scene: Scene) -> None:
    exact = SceneCamera(plate_scene, camera(), quality="exact")
    for pose in POSES.values():
        grey = exact.render(0, {"plate": pose}, noise=0, depth=False).bgr[:, :, 1]
        for edge in seen_square(pose, MARKER.size_mm, DISTORTION, "pinhole"):
            assert abs(edge_offsets(grey, edge[6:-6], 4.0).mean()) < 0.006


def test_the_white_border_ends_where_the_paper_does(plate_scene: Scene) -> None:
    scene_camera = SceneCamera(plate_scene, camera())
    pose = POSES["tilted"]
    grey = scene_camera.render(0, {"plate": pose}, noise=0, blur_px=0, depth=False).bgr[:, :, 1]
    for edge in seen_square(pose, MARKER.size_mm + 2 * MARKER.border_mm, DISTORTION, "pinhole"):
        # Here it is white inside and board outside: the same area with the sign turned by the normalisation.
        assert abs(edge_offsets(grey, edge[6:-6], 4.0).mean()) < 0.03


def test_truth_is_the_projection_by_hand(plate_scene: Scene) -> None:
    scene_camera = SceneCamera(plate_scene, camera())
    for pose in POSES.values():
        (truth,) = scene_camera.render(0, {"plate": pose}, depth=False).truth
        x, z = 130.0, 100.0
        signs = [(-1, 1), (1, 1), (1, -1), (-1, -1)]
        corners = np.array([(sx * x, y, sz * z) for y in (-2.0, 2.0) for sx, sz in signs])
        pixels = projected(corners @ pose.rotation.T + pose.translation)
        assert np.abs(np.array(truth.corners) - pixels).max() < 1e-6
        window = truth.window
        assert (window.x_min, window.y_min) == pytest.approx(tuple(pixels.min(axis=0)), abs=1e-6)
        assert (window.x_max, window.y_max) == pytest.approx(tuple(pixels.max(axis=0)), abs=1e-6)
        assert truth.distance_mm == pytest.approx(np.sqrt((pose.translation**2).sum()))
        assert truth.tvec_mm == pytest.approx(tuple(pose.translation))
        (marker,) = truth.markers
        quad = seen_square(pose, MARKER.size_mm, DISTORTION, "pinhole")[:, 0]
        assert np.abs(np.array(marker.corners) - quad).max() < 1e-6
        assert marker.visible


def test_offset_and_rotation_follow_the_design(tags: Family) -> None:
    """On a left side, right is -Y and up +Z; a marker turned by 90 degrees has its top at the side's left."""
    turned = MarkerOnSide(3, 40.0, 5.0, (20.0, -35.0, 6.0), 90.0)
    box = plate(turned)
    box = type(box)("b", "b", (200.0, 150.0, 120.0), (type(box.sides[0])("left", "left", (turned,)),))
    scene = Scene([box], tags, clutter=0.0, light=0.0)
    # The left side (-X) towards the camera: the object's -Y, right of that side, points right in the picture.
    rotation = np.array([[0, -1.0, 0], [0, 0, -1.0], [1.0, 0, 0]])
    pose = Pose(rotation, np.array([0.0, 0, 500]))
    (truth,) = scene.render(camera(), {"b": pose}, depth=False).truth
    depth = 500 - 100 - 6  # the side's distance, less what the carrier sticks out
    middle = np.array([20.0, 35.0])  # offset right and up, in a picture with y down
    # TL of a marker turned counter-clockwise by 90 degrees is the side's bottom left.
    corners = middle + np.array([[-20, 20], [-20, -20], [20, -20], [20, 20]])
    pixels = projected(np.column_stack([corners, np.full(4, depth)]))
    assert np.abs(np.array(truth.markers[0].corners) - pixels).max() < 1e-6


def test_the_april_tag_library_finds_the_corners_of_the_truth(tags: Family) -> None:
    """Independent of cv2's dictionaries: order and half pixel as measured for pupil-apriltags.

    It lays straight lines through edges that a lens has bent, and is at its worst on edges along the pixel rows;
    so it is only as good as its own method elsewhere.
    """
    limits, pictures, truths = [], [], []
    scene = Scene([plate(MARKER)], tags, light=0.0)
    for lens_name, (distortion, model) in CAMERAS.items():
        scene_camera = SceneCamera(scene, camera(distortion, model))
        for name, pose in POSES.items():
            rendered = scene_camera.render(0, {"plate": pose}, noise=0, depth=False)
            pictures.append(cv2.cvtColor(rendered.bgr, cv2.COLOR_BGR2GRAY))
            truths.append(np.array(rendered.truth[0].markers[0].corners))
            limits.append(0.15 if lens_name in ("plain", "distorted") and name != "facing" else 0.6)
    found = april_tag_corners(pictures)
    assert [[tag for tag, _ in tags_found] for tags_found in found] == [[MARKER.id]] * len(pictures)
    errors = np.array(
        [np.array(corners)[[3, 2, 1, 0]] - 0.5 - truth for ((_, corners),), truth in zip(found, truths, strict=True)]
    )
    assert (np.linalg.norm(errors, axis=2).max(axis=1) < limits).all()
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.05


def test_an_upright_tag_is_drawn_as_its_makers_draw_it(tags: Family) -> None:
    """Tag 7 of 36h11: the bits of AprilTag's own picture are cv2's, turned by 180 degrees."""
    scene = Scene([plate(MARKER)], tags, clutter=0.0, light=0.0)
    pose = posed((0, 0, 0), (0, 0, 300))
    grey = scene.render(camera(np.zeros(5)), {"plate": pose}, noise=0, blur_px=0, depth=False).bgr[:, :, 1]
    cell = 600 * 80 / 298 / 8
    at = np.rint((np.arange(8) - 3.5) * cell).astype(int)
    bits = grey[np.ix_(at + 240, at + 320)] > 128
    drawn = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36H11), 7, 8) > 0
    assert (bits == drawn[::-1, ::-1]).all()
    assert not (bits == drawn).all()


@pytest.mark.parametrize("name", sorted(POSES))
def test_depth_is_the_plane_along_the_axis(plate_scene: Scene, name: str) -> None:
    pose = POSES[name]
    rendered = plate_scene.render(camera(), {"plate": pose}, depth_noise_mm=0)
    assert rendered.depth is not None
    outline = seen_square(pose, 190.0, DISTORTION, "pinhole").reshape(-1, 2)
    inside = np.zeros((480, 640), np.uint8)
    cv2.fillPoly(inside, [np.rint(outline).astype(np.int32)], 1)
    inside = cv2.erode(inside, np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(inside)
    pixels = np.column_stack([columns, rows]).astype(np.float64)[:, None]
    rays = cv2.undistortPoints(pixels, MATRIX, DISTORTION)[:, 0]
    normal = pose.rotation @ np.array([0, -1.0, 0])
    on_plane = pose.rotation @ np.array([0, -SURFACE_MM, 0]) + pose.translation
    expected = normal @ on_plane / (np.column_stack([rays, np.ones(len(rays))]) @ normal)
    assert len(rows) > 10_000
    assert np.abs(rendered.depth[rows, columns] - expected).max() < 0.51
    # The room is behind it, everywhere.
    assert (rendered.depth > 0).all()
    assert rendered.depth[5, 5] > expected.max()


def test_a_straight_edge_is_bent_by_the_lens(plate_scene: Scene) -> None:
    """What distortion does is in the pixels, not only in the truth: the edge's middle leaves the chord."""
    model = CameraModel(640, 480, MATRIX, np.array([-0.35, 0.12, 0, 0, 0.0]))
    pose = posed((0, 0, 0), (0, -105, 430))
    edges = seen_square(pose, MARKER.size_mm, model.distortion, "pinhole")
    top = edges[0]
    chord = (top[0] + top[-1]) / 2
    assert np.linalg.norm(top[20] - chord) > 0.3
    grey = plate_scene.render(model, {"plate": pose}, noise=0, depth=False).bgr[:, :, 1]
    assert abs(edge_offsets(grey, top[6:-6], 4.0).mean()) < 0.006
